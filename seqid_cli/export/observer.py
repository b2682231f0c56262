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

_POSITIONS = 41


@dataclass(frozen=True)
class Thresholds:
    """Limits of a momentum observer."""

    gain: float  # 1/s
    limit: Array  # (n,) N m, infinite where the error of a joint is not known
    # (n,) N m, within +- of which friction is known to lie at speeds below `slow`
    stiction: Array
    slow: Array  # (n,) rad/s


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
    """Find limits that a model's own error crosses once in `hours_between_alarms` of the whole arm.

    `mass` (n, n): largest entries of the mass matrix, kg m^2. `errors`: RMS torque
    error of each joint [N m]; those of the inertia stage if left out. `margin`: by how
    much other logs may be worse than those of the error, and its tails heavier.
    `usual_cutoff_hz`: the band of the error where the file does not tell it, Hz.
    """
    rigid = stages.inertia or stages.gravity
    band = (rigid.cutoff_hz if rigid else None) or usual_cutoff_hz
    found = errors or (rigid.rmse if rigid else {})
    error = np.array([found.get(name, math.inf) for name in robot.joint_names])
    steps = np.array([joint.encoder_resolution or 0.0 for joint in robot.joints])
    jerky = np.hypot.reduce(mass * steps, axis=1) / math.sqrt(12.0)
    # The noise of the band goes through, the encoder's up to as much, motion slower
    # than the band.
    quiet = float(np.sqrt(error / np.maximum(jerky, 1e-12)).min())
    gain = min(max(quiet, band), 4.0 * band)
    times = 2.0 * robot.n * band * 3600.0 * hours_between_alarms
    factor = margin * math.sqrt(2.0 * math.log(max(times, math.e)))
    stiction, slow = np.zeros(robot.n), np.zeros(robot.n)
    for j, surface in enumerate(surfaces):
        if surface is not None:
            q = np.linspace(*surface.scaling.position, _POSITIONS)
            stiction[j] = np.abs(surface.at_rest(q)).max()
            slow[j] = max(surface.scaling.speed[0], SLIDES * surface.sign_width)
    return Thresholds(gain, factor * np.hypot(error, gain**2 * jerky), stiction, slow)


def largest_mass(
    robot: Robot, bodies: Array, armature: Array, *, positions: int = 64
) -> Array:
    """Return the largest entries (n, n) of the mass matrix over random positions, kg m^2."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, size=(positions, robot.n))
    rest, zero = np.zeros_like(q), np.zeros(3)
    pushes = (np.broadcast_to(unit, q.shape) for unit in np.eye(robot.n))
    columns = [
        inverse_dynamics(robot.chain, zero, bodies, q, rest, ddq) for ddq in pushes
    ]
    return np.asarray(np.abs(np.stack(columns, axis=2)).max(axis=0) + np.diag(armature))
