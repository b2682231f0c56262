"""The identified model as a sum of torques: friction, rigid body, rotors.

Friction steps where a joint reverses, so its spectrum goes far beyond half of a thinned
rate, and samples of it say only to half a sample when it stepped. Around reversals the
velocity is therefore interpolated, friction computed at `PARTS` points per sample, and
these go through a short low-pass that passes what the motion's own one does (it is flat
up to twice the cut-off at ten samples per period) and stops what would be folded back
there. Elsewhere friction is as smooth as the motion; where samples are many per period
of the cut-off, what would be folded back is little and far above.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from seqid_cli.model.friction import (
    FrictionFamily,
    FrictionLaw,
    FrictionSurface,
    IdentifiedRange,
    friction_torque,
)
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import STANDARD, gear_ratios, standard_names
from seqid_cli.robot.regressor import Coupling, inverse_dynamics, rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.running import dilated, running_min
from seqid_cli.typing import Array, Index, Mask

PARTS = 8  # points per sample at which friction is computed where a joint reverses
HALF = 4  # samples on either side that their low-pass reaches
KNOTS = np.arange(-2, 4)  # samples about a point that it is interpolated from
# Lagrange's weights (6, PARTS) of the knots for the points from a sample to the next.
POINTS = np.vander(np.arange(PARTS) / PARTS, len(KNOTS), increasing=True)
WEIGHTS = np.linalg.solve(np.vander(KNOTS, increasing=True).T, POINTS.T)
REACH = 0.25  # periods of the cut-off, over which the low-pass mixes samples


def friction_surfaces(stages: Stages, robot: Robot) -> list[FrictionSurface | None]:
    """Return each joint's friction in the robot's order; None where not identified."""
    joints = stages.friction.joints if stages.friction else {}
    surfaces: list[FrictionSurface | None] = []
    for name in robot.joint_names:
        joint = joints.get(name)
        surfaces.append(None if joint is None else FrictionSurface.from_stage(joint))
    return surfaces


@dataclass(frozen=True)
class Predicted:
    """The torque that a model, or a part of it, predicts for a log.

    What was measured there plays no part.

    Attributes
    ----------
    value : Array
        (N, n) N m, filtered like `motion.tau`.
    low, high : Array
        (N, n) N m, bounds of what the model allows. Coulomb's law at rest is an
        interval; where a joint slides both are `value`. For effects they are what
        these add to friction's interval.
    """

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, kw_only=True)
class TorqueModel:
    """Everything identified so far, ready to predict.

    Attributes
    ----------
    robot : Robot
    surfaces : list of FrictionSurface or None
        By joint; None where friction has not been identified.
    phi : Array, optional
        (n, 10) representative link parameters; None without a rigid-body stage.
    rotor : Array, optional
        (n,) kg m^2 on the motor side; None without a rigid-body stage.
    coupling : Coupling
        How rotors act on the links that carry them.
    delays_s : Array, optional
        (n,) s, by which torques are logged late.
    rotor_std : Array, optional
        (n,) kg m^2, standard errors of `rotor`; infinite where neither a stage nor the
        robot file tells a rotor from its link.
    """

    robot: Robot
    surfaces: list[FrictionSurface | None]
    phi: Array | None
    rotor: Array | None
    coupling: Coupling
    delays_s: Array | None = None
    rotor_std: Array | None = None

    @classmethod
    def from_stages(cls, stages: Stages, robot: Robot) -> Self:
        """Build from the inertia stage, else from gravity, else from friction."""
        rigid = stages.inertia or stages.gravity
        phi: Array | None = None
        rotor: Array | None = None
        coupling: Coupling = "diagonal"
        if rigid is not None:
            phi, rotor = standard_parameters(rigid, robot.n)
            if rigid.rotor_coupling == "gyroscopic":
                coupling = "gyroscopic"
        return cls(
            robot=robot,
            surfaces=friction_surfaces(stages, robot),
            phi=phi,
            rotor=rotor,
            coupling=coupling,
            delays_s=delays_s(stages, robot),
            rotor_std=rotor_std_errors(rigid, robot),
        )

    def friction(self, q: Array, dq: Array) -> Array:
        """Compute the friction torque (N, n) N m."""
        return friction_torque(self.surfaces, q, dq)

    def friction_of(self, joint: int, q: Array, v: Array) -> Array:
        """Compute a joint's friction torque (N,) N m at q, v (N,)."""
        surface = self.surfaces[joint]
        return np.zeros(len(q)) if surface is None else surface.torque(q, v)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Compute the rigid-body, gravity and rotor torque.

        Parameters
        ----------
        q, dq, ddq : Array
            (N, n) rad, rad/s, rad/s^2.

        Returns
        -------
        Array
            (N, n) N m; zero without a rigid-body stage.
        """
        if self.phi is None or self.rotor is None:
            return np.zeros_like(q)
        torque = inverse_dynamics(
            self.robot.chain, self.robot.gravity, self.phi, q, dq, ddq
        )
        if self.rotor.any():
            torque = torque + self.rotors(q, dq, ddq)
        return torque

    def rotors(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Compute the torque (N, n) N m that turns the motors' rotors."""
        if self.rotor is None or not self.rotor.any():
            return np.zeros_like(q)
        Y = rotor_regressor(
            self.robot.chain, q, dq, ddq, gear_ratios(self.robot), self.coupling
        )
        return Y @ self.rotor

    def predict(self, motion: Motion) -> Array:
        """Predict the torque (N, n) N m, filtered like `motion.tau`."""
        rigid, friction = self._terms(motion)
        return rigid + friction

    def _terms(self, motion: Motion) -> tuple[Array, Array]:
        """Compute rigid-body and friction torque, each filtered like `motion.tau`."""
        rigid = motion.filtered(self.rigid(motion.q, motion.dq, motion.ddq))
        friction = motion.filtered(sampled_friction(self.surfaces, motion), times=2)
        return self.late(rigid, motion), self.late(friction, motion)

    def late(self, torque: Array, motion: Motion) -> Array:
        """Return torque (N, n) N m as it is logged, late by each joint's delay."""
        if self.delays_s is None or not self.delays_s.any():
            return torque
        samples = np.arange(len(torque), dtype=np.float64)
        delays = self.delays_s * motion.rate_hz
        late = [
            np.interp(samples - delay, samples, values)
            for delay, values in zip(delays, torque.T, strict=True)
        ]
        return np.stack(late, axis=1)

    def predict_set(
        self, motion: Motion, slides: Mask, added: Predicted | None = None
    ) -> Predicted:
        """Predict the torque that the model allows.

        It is one value where joints slide, and an interval at rest: there friction
        takes whatever value balances, up to what it has at the slowest speed. The
        interval holds the model's own value as well, which near the onset of motion may
        lie beyond. The measured torque plays no part.

        Parameters
        ----------
        motion : Motion
        slides : Mask
            (N, n), where joints certainly slide.
        added : Predicted, optional
            What effects add, in either state.
        """
        rigid, friction = self._terms(motion)
        if added is not None:
            rigid = rigid + added.value
        value = rigid + friction

        low = value.copy()
        high = value.copy()
        for j, surface in enumerate(self.surfaces):
            if surface is None:
                continue
            friction_low, friction_high = surface.at_rest(motion.q[:, j])
            if added is not None:
                friction_low = friction_low + added.low[:, j]
                friction_high = friction_high + added.high[:, j]
            rests = ~slides[:, j]
            lowest = np.minimum(value[:, j], rigid[:, j] + friction_low)
            highest = np.maximum(value[:, j], rigid[:, j] + friction_high)
            low[rests, j] = lowest[rests]
            high[rests, j] = highest[rests]
        return Predicted(value, low, high)

    def outside(self, motion: Motion) -> Mask:
        """Return samples (N, n) at which a joint's friction was never identified."""
        return outside_of(self.identified_ranges, motion)

    @property
    def identified_ranges(self) -> tuple[IdentifiedRange | None, ...]:
        """By joint, where friction was identified; None where it is not known."""
        return tuple(
            None if surface is None else surface.identified_range
            for surface in self.surfaces
        )


def outside_of(ranges: Sequence[IdentifiedRange | None], motion: Motion) -> Mask:
    """Return samples (N, n) of a motion beyond each joint's range, if it has one."""
    outside = np.zeros(motion.q.shape, dtype=bool)
    for j, identified in enumerate(ranges):
        if identified is not None:
            outside[:, j] = identified.outside(motion.q[:, j], motion.dq[:, j])
    return outside


def delays_s(stages: Stages, robot: Robot) -> Array:
    """Return the delays (n,) s of torques against positions, zero where not known."""
    joints = stages.friction.joints if stages.friction else {}
    delays = {}
    for name, joint in joints.items():
        for term in joint.nuisances:
            if term.name == "delay":
                delays[name] = term.value
    return np.array([delays.get(name, 0.0) for name in robot.joint_names])


def standard_parameters(stage: RigidStage, n: int) -> tuple[Array, Array]:
    """Return representative links (n, 10) and rotor inertias (n,) of a stage."""
    values = np.array(
        [stage.representative.get(name, 0.0) for name in standard_names(n)]
    )
    of_links = len(STANDARD) * n
    return values[:of_links].reshape(n, len(STANDARD)), values[of_links:]


def rotor_std_errors(stage: RigidStage | None, robot: Robot) -> Array:
    """Return standard errors (n,) kg m^2 of the rotors' inertias.

    They are zero where the robot file gives an inertia, and infinite where nothing
    tells it.
    """
    identified = {} if stage is None else {x.name: x for x in stage.parameters}
    std_errors = np.full(robot.n, np.inf)
    for number, joint in enumerate(robot.joints):
        name = f"Ia_{number + 1}"
        if joint.rotor_inertia is not None:
            std_errors[number] = 0.0
        elif name in identified:
            std_errors[number] = identified[name].uncertainty
    return std_errors


def known_rotors(robot: Robot) -> Array:
    """Return the robot file's rotor inertias (n,) kg m^2; zero where not given."""
    return np.array([joint.rotor_inertia or 0.0 for joint in robot.joints])


def sliding(motion: Motion, slowest: Array, *, reach_periods: float = REACH) -> Mask:
    """Return samples at which a joint certainly slides: friction opposes its motion.

    At rest, and where the filter mixes rest in, friction is anything up to stiction.

    Parameters
    ----------
    motion : Motion
    slowest : Array
        (n,) speeds [rad/s; m/s where prismatic] from which a joint slides.
    reach_periods : float
        Periods of the cut-off over which the filter mixes on either side.

    Returns
    -------
    Mask
        (N, n).
    """
    velocity = np.where(motion.moving, motion.dq, 0.0)
    near = slowest_near(motion, velocity, reach_periods=reach_periods)
    return np.asarray((near >= slowest) & (near > 0.0) & motion.usable[:, None])


def slowest_near(
    motion: Motion,
    velocity: Array,
    *,
    per_period: float = 80.0,
    reach_periods: float = REACH,
) -> Array:
    """Return the smallest speeds within some periods of the cut-off around each sample.

    Parameters
    ----------
    motion : Motion
    velocity : Array
        (N, k).
    per_period : float
        Points per period of the cut-off that are looked at.
    reach_periods : float
        Periods on either side.

    Returns
    -------
    Array
        (N, k), without sign.
    """
    cutoff_hz = motion.lowpass.cutoff_hz
    parts = max(1, math.ceil(per_period * cutoff_hz / motion.rate_hz))

    reach = max(1, int(reach_periods * motion.rate_hz * parts / cutoff_hz))

    # Velocities are joined by straight lines, so that thinning does not hide a reversal
    # between two samples. One at a time: the points between samples take much room.
    share = np.arange(parts) / parts
    slowest = np.empty_like(velocity)
    for column, values in enumerate(velocity.T):
        following = np.append(values[1:], values[-1:])
        between = values[:, None] * (1.0 - share) + following[:, None] * share
        speed = np.abs(between).ravel()
        nearest = running_min(speed, 2 * reach + 1)
        slowest[:, column] = nearest[::parts]
    return slowest


def sampled_friction(
    surfaces: Sequence[FrictionLaw | None], motion: Motion, *, dense: float = 80.0
) -> Array:
    """Compute the friction torque of a motion, its steps kept below half of the rate.

    Parameters
    ----------
    surfaces : sequence of FrictionLaw or None
        By joint.
    motion : Motion
    dense : float
        Samples per period of the cut-off from which steps need no care.

    Returns
    -------
    Array
        (N, n) [N m; N where prismatic], before the motion's own low-pass; zero for a
        joint whose friction is not known.
    """
    torque = friction_torque(surfaces, motion.q, motion.dq)
    return _of_motion(torque, surfaces, motion, dense)


def sampled_families(
    families: Sequence[FrictionFamily | None],
    motion: Motion,
    *,
    size: int,
    dense: float = 80.0,
) -> Array:
    """Compute what `sampled_friction` does for several surfaces of each joint at once.

    Parameters
    ----------
    families : sequence of FrictionFamily or None
        By joint, each of `size` members.
    motion : Motion
    size : int
    dense : float
        Samples per period of the cut-off from which steps need no care.

    Returns
    -------
    Array
        (N, n, size) N m per unit of each member.
    """
    torque = friction_torque(families, motion.q, motion.dq, members=(size,))
    return _of_motion(torque, families, motion, dense)


def _of_motion(
    torque: Array,
    laws: Sequence[FrictionLaw | FrictionFamily | None],
    motion: Motion,
    dense: float,
) -> Array:
    """Make friction at samples (N, n[, m]), in place, that of a sampled motion."""
    if motion.rate_hz >= dense * motion.lowpass.cutoff_hz:
        return _warmed(torque, laws, motion)

    # Samples whose interpolation and low-pass stay within valid ones.
    inside = shrink(motion.valid, HALF + len(KNOTS) // 2)
    for j, law in enumerate(laws):
        if law is None:
            continue
        reverses = _near_reversals(motion, j, law.sign_width)
        near = np.flatnonzero(inside & reverses)
        if near.size:
            torque[near, j] = _band_limited(law, motion.q[:, j], motion.dq[:, j], near)
    return _warmed(torque, laws, motion)


def _warmed(
    torque: Array,
    laws: Sequence[FrictionLaw | FrictionFamily | None],
    motion: Motion,
) -> Array:
    """Scale friction torque (N, n, ...) N m, in place, to the logged temperatures."""
    if motion.celsius is None:
        return torque
    for j, law in enumerate(laws):
        if law is not None and law.per_kelvin:
            # Samples are the last axis of the transpose, whatever axes follow them.
            torque[:, j].T[...] *= law.warmed(motion.celsius[:, j])
    return torque


def _near_reversals(motion: Motion, j: int, width: float, *, wide: float = 3.0) -> Mask:
    """Return samples (N,) that the low-pass reaches from where a joint reverses.

    A moving joint reverses where it is slower than `wide` widths of the sign.
    """
    v = motion.dq[:, j]
    moving = motion.moving[:, j]
    slow = np.abs(v) < wide * width

    # Between two samples; both of them are then near.
    reverses = (v[1:] * v[:-1] <= 0) | slow[1:] | slow[:-1]
    reverses &= moving[1:] & moving[:-1]
    near: Mask = np.zeros(len(v), dtype=np.bool_)
    near[:-1] = reverses
    near[1:] |= reverses
    return dilated(near, HALF)


def _band_limited(
    law: FrictionLaw | FrictionFamily, q: Array, dq: Array, near: Index
) -> Array:
    """Compute low-passed friction (M, ...) at samples `near` (M,) of a motion (N,)."""
    around = np.arange(-HALF, HALF + 1)
    used = np.unique(near[:, None] + around)

    # Friction at PARTS points from each sample that is used to the next.
    knots = used[:, None] + KNOTS
    q_points = q[knots] @ WEIGHTS
    dq_points = dq[knots] @ WEIGHTS
    torque = law.torque(q_points.ravel(), dq_points.ravel())
    torque = torque.reshape(len(used), PARTS, *torque.shape[1:])

    windows = np.searchsorted(used, near)[:, None] + around
    return np.asarray(np.tensordot(torque[windows], _taps(), axes=((1, 2), (0, 1))))


@lru_cache(maxsize=1)
def _taps(*, beta: float = 7.5) -> Array:
    """Return the low-pass (2 HALF + 1, PARTS) over the points around a sample."""
    middle = HALF * PARTS
    at = np.arange(-middle, middle + 1)
    window = np.i0(beta * np.sqrt(1.0 - (at / middle) ** 2))
    lowpass = np.sinc(at / PARTS) * window
    taps = np.zeros((2 * HALF + 1) * PARTS)
    taps[: len(at)] = lowpass / lowpass.sum()
    return taps.reshape(2 * HALF + 1, PARTS)
