"""When a momentum observer raises an alarm: limits from the identified noise.

The observer of the exported code low-passes the external torque twice at the gain K.
Luca, Albu-Schaeffer, Haddadin, Hirzinger, "Collision detection and safe reaction with
the DLR-III lightweight manipulator arm", IROS 2006. A Gaussian residual of standard
deviation s in the band up to f crosses +-h no more than 2 f exp(-h^2 / 2 s^2) times a
second (Rice, 1945). An encoder of steps d adds no more than K^2 M d / sqrt(12) to it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot

_POSITIONS = 41  # over the identified range, at which friction at rest is looked at


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits of a momentum observer.

    Attributes
    ----------
    gain : float
        The observer's K, 1/s.
    limit : (n,) array
        External torque that raises an alarm, N m (N where prismatic), infinite where
        the error of a joint is not known.
    stiction : (n,) array
        Within plus and minus this torque friction is known to lie at speeds below
        `slow`, N m.
    slow : (n,) array
        Speeds below which a joint may stand, rad/s (m/s).
    """

    gain: float
    limit: Array
    stiction: Array
    slow: Array


def thresholds(
    robot: Robot,
    stages: Stages,
    surfaces: Sequence[FrictionSurface | None],
    mass: Array,
    errors: Mapping[str, float] | None = None,
    *,
    hours_between_alarms: float = 24.0,
    margin: float = 1.5,
    usual_cutoff_hz: float = 10.0,
) -> Thresholds:
    """Find limits that a model's own error crosses rarely.

    Parameters
    ----------
    robot : Robot
        The arm.
    stages : Stages
        What was identified: its band, and its error where `errors` are not given.
    surfaces : sequence of FrictionSurface or None
        Friction of each joint.
    mass : (n, n) array
        Largest entries of the mass matrix, kg m^2.
    errors : mapping of str to float, optional
        RMS torque error of each joint, N m; that of the inertia stage by default.
    hours_between_alarms : float
        Mean time between false alarms of the whole arm, h.
    margin : float
        By how much other logs may be worse than those of the error, and its tails
        heavier.
    usual_cutoff_hz : float
        The band of the error where the file does not tell it, Hz.
    """
    rigid = stages.inertia or stages.gravity
    band_hz = (rigid.cutoff_hz if rigid else None) or usual_cutoff_hz
    stated = errors or (rigid.rmse if rigid else {})
    error = np.array([stated.get(name, math.inf) for name in robot.joint_names])

    # Steps of encoders, as torque per K^2. The gain lets through the noise of the
    # band, the encoders' up to as much, and motion slower than the band.
    steps = np.array([joint.encoder_resolution or 0.0 for joint in robot.joints])
    step_noise = np.hypot.reduce(mass * steps, axis=1) / math.sqrt(12.0)
    quiet_gain = float(np.sqrt(error / np.maximum(step_noise, 1e-12)).min())
    gain = min(max(quiet_gain, band_hz), 4.0 * band_hz)

    # Rice's formula solved for h, a false alarm of n joints in so many hours.
    crossings = 2.0 * robot.n * band_hz * 3600.0 * hours_between_alarms
    factor = margin * math.sqrt(2.0 * math.log(max(crossings, math.e)))

    stiction = np.zeros(robot.n)
    slow = np.zeros(robot.n)
    for j, surface in enumerate(surfaces):
        if surface is not None:
            q = np.linspace(*surface.scaling.position, _POSITIONS)
            stiction[j] = np.abs(surface.at_rest(q)).max()
            slow[j] = max(surface.scaling.speed[0], SLIDES * surface.sign_width)
    return Thresholds(
        gain=gain,
        limit=factor * np.hypot(error, gain**2 * step_noise),
        stiction=stiction,
        slow=slow,
    )


def largest_mass(
    robot: Robot, bodies: Array, armature: Array, *, positions: int = 64
) -> Array:
    """Return the largest entries of the mass matrix over random positions.

    Parameters
    ----------
    robot : Robot
        The arm.
    bodies : (n, 10) array
        Standard parameters of the bodies.
    armature : (n,) array
        Inertias of rotors as the joints feel them, kg m^2 (kg where prismatic).
    positions : int
        How many positions are drawn, each joint from -pi to pi.

    Returns
    -------
    (n, n) array
        Sizes, kg m^2 (kg m, kg), the rotors on the diagonal.
    """
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, size=(positions, robot.n))
    no_velocity = np.zeros_like(q)
    no_gravity = np.zeros(3)

    # A column is the torque of one joint's unit acceleration from rest.
    columns = []
    for unit in np.eye(robot.n):
        ddq = np.broadcast_to(unit, q.shape)
        columns.append(
            inverse_dynamics(robot.chain, no_gravity, bodies, q, no_velocity, ddq)
        )
    sizes = np.abs(np.stack(columns, axis=2)).max(axis=0)
    return np.asarray(sizes + np.diag(armature))
