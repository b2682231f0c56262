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
from scipy.ndimage import binary_dilation, minimum_filter1d
from scipy.signal import firwin

from seqid_cli.model.friction import FrictionLaw, FrictionSurface, friction_torque
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import STANDARD, gear_ratios, standard_names
from seqid_cli.robot.regressor import Coupling, inverse_dynamics, rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

PARTS = 8  # points per sample at which friction is computed where a joint reverses
HALF = 4  # samples on either side that their low-pass reaches
KNOTS = np.arange(-2, 4)  # samples about a point that it is interpolated from
# Lagrange's weights (6, PARTS) of the knots for the points from a sample to the next.
POINTS = np.vander(np.arange(PARTS) / PARTS, len(KNOTS), increasing=True)
WEIGHTS = np.linalg.solve(np.vander(KNOTS, increasing=True).T, POINTS.T)
REACH = 0.25  # periods of the cut-off, over which the low-pass mixes samples


def friction_surfaces(stages: Stages, robot: Robot) -> list[FrictionSurface | None]:
    """Friction of each joint in the robot's order; None where it has not been identified."""
    found = stages.friction.joints if stages.friction else {}
    told = (found.get(name) for name in robot.joint_names)
    return [
        None if joint is None else FrictionSurface.from_stage(joint) for joint in told
    ]


@dataclass(frozen=True)
class Predicted:
    """What a model, or a part of it, says of the torque of a log, whatever was measured there.

    `value` (N, n) N m is filtered like `motion.tau`. Coulomb's law at rest is an
    interval: `low`, `high` (N, n) N m bound what the model allows, where a joint slides
    `value` alone; of effects they are what these add to friction's interval.
    """

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class TorqueModel:
    """Everything identified so far, ready to predict.

    `phi` (n, 10) representative link parameters, `rotor` (n,) kg m^2, both None without
    a rigid-body stage.
    """

    robot: Robot
    surfaces: list[FrictionSurface | None]
    phi: Array | None
    rotor: Array | None
    coupling: Coupling
    delays_s: Array | None = None

    @classmethod
    def from_stages(cls, stages: Stages, robot: Robot) -> Self:
        """Use the inertia stage where there is one, else gravity alone, else friction alone."""
        rigid = stages.inertia or stages.gravity
        surfaces = friction_surfaces(stages, robot)
        if rigid is None:
            return cls(robot, surfaces, None, None, "diagonal", delays_s(stages, robot))
        phi, rotor = standard_parameters(rigid, robot.n)
        coupling: Coupling = (
            "gyroscopic" if rigid.rotor_coupling == "gyroscopic" else "diagonal"
        )
        return cls(robot, surfaces, phi, rotor, coupling, delays_s(stages, robot))

    def friction(self, q: Array, dq: Array) -> Array:
        """Friction torque (N, n) N m."""
        return friction_torque(self.surfaces, q, dq)

    def friction_of(self, joint: int, q: Array, v: Array) -> Array:
        """Friction torque (N,) N m of one joint at its positions and velocities (N,)."""
        surface = self.surfaces[joint]
        return np.zeros(len(q)) if surface is None else surface.torque(q, v)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Rigid-body, gravity and rotor torque (N, n) N m."""
        if self.phi is None or self.rotor is None:
            return np.zeros_like(q)
        torque = inverse_dynamics(
            self.robot.chain, self.robot.gravity, self.phi, q, dq, ddq
        )
        return torque + self.rotors(q, dq, ddq) if self.rotor.any() else torque

    def rotors(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (N, n) N m that turns the motors' rotors."""
        if self.rotor is None or not self.rotor.any():
            return np.zeros_like(q)
        Y = rotor_regressor(
            self.robot.chain, q, dq, ddq, gear_ratios(self.robot), self.coupling
        )
        return Y @ self.rotor

    def predict(self, motion: Motion) -> Array:
        """Torque (N, n) N m, filtered like `motion.tau` so that both can be compared."""
        rigid, friction = self._terms(motion)
        return rigid + friction

    def _terms(self, motion: Motion) -> tuple[Array, Array]:
        """Rigid-body and friction torque, each filtered like `motion.tau`."""
        rigid = motion.filtered(self.rigid(motion.q, motion.dq, motion.ddq))
        friction = motion.filtered(sampled_friction(self.surfaces, motion), times=2)
        return self.late(rigid, motion), self.late(friction, motion)

    def late(self, torque: Array, motion: Motion) -> Array:
        """Return torque (N, n) N m as it is logged, late by each joint's delay."""
        if self.delays_s is None or not self.delays_s.any():
            return torque
        samples = np.arange(len(torque), dtype=np.float64)
        shifts = self.delays_s * motion.rate_hz
        columns = [
            np.interp(samples - shift, samples, values)
            for shift, values in zip(shifts, torque.T, strict=True)
        ]
        return np.stack(columns, axis=1)

    def predict_set(
        self, motion: Motion, slides: Mask, added: Predicted | None = None
    ) -> Predicted:
        """Torque that the model allows: one value where joints slide, an interval at rest.

        At rest friction takes whatever value balances, up to what it has at the slowest
        speed; the interval holds the model's own value as well, which near the onset of
        motion may lie beyond. What effects add is there in either state. The measured
        torque plays no part.
        """
        rigid, friction = self._terms(motion)
        if added is not None:
            rigid = rigid + added.value
        value = rigid + friction
        low, high = value.copy(), value.copy()
        for j, surface in enumerate(self.surfaces):
            if surface is not None:
                least, most = surface.at_rest(motion.q[:, j])
                if added is not None:
                    least, most = least + added.low[:, j], most + added.high[:, j]
                rests = ~slides[:, j]
                low[rests, j] = np.minimum(value[:, j], rigid[:, j] + least)[rests]
                high[rests, j] = np.maximum(value[:, j], rigid[:, j] + most)[rests]
        return Predicted(value, low, high)

    def outside(self, motion: Motion) -> Mask:
        """Samples (N, n) at which a joint's friction was never identified."""
        found = np.zeros(motion.q.shape, dtype=bool)
        for j, surface in enumerate(self.surfaces):
            if surface is not None:
                found[:, j] = surface.outside(motion.q[:, j], motion.dq[:, j])
        return found


def delays_s(stages: Stages, robot: Robot) -> Array:
    """Delays (n,) s of the joints' torques against their positions, zero where none is known."""
    joints = stages.friction.joints if stages.friction else {}
    found = {
        name: term.value
        for name, joint in joints.items()
        for term in joint.nuisances
        if term.name == "delay"
    }
    return np.array([found.get(name, 0.0) for name in robot.joint_names])


def standard_parameters(stage: RigidStage, n: int) -> tuple[Array, Array]:
    """Representative link parameters (n, 10) and rotor inertias (n,) of a stage."""
    values = np.array(
        [stage.representative.get(name, 0.0) for name in standard_names(n)]
    )
    links = len(STANDARD) * n
    return values[:links].reshape(n, len(STANDARD)), values[links:]


def known_rotors(robot: Robot) -> Array:
    """Rotor inertias (n,) kg m^2 of the robot file; zero where they are to be identified."""
    return np.array([joint.rotor_inertia or 0.0 for joint in robot.joints])


def sliding(motion: Motion, slowest: Array, *, reach_periods: float = REACH) -> Mask:
    """Samples (N, n) at which a joint certainly slides, so that friction opposes its motion.

    At rest, and where the filter mixes rest in, friction is anything up to stiction.
    The filter is taken to mix over `reach_periods` of its cut-off on either side.
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
    """Least of velocities (N, k) within some periods of the cut-off, without sign."""
    cutoff = motion.lowpass.cutoff_hz
    parts = max(1, math.ceil(per_period * cutoff / motion.rate_hz))
    share = (np.arange(parts) / parts)[:, None]
    # Straight between samples, so that thinning does not hide a reversal between two.
    ahead = np.concatenate([velocity[1:], velocity[-1:]])[:, None]
    fine = np.abs(velocity[:, None] * (1.0 - share) + ahead * share).reshape(
        -1, velocity.shape[1]
    )
    size = 2 * max(1, int(reach_periods * motion.rate_hz * parts / cutoff)) + 1
    return np.asarray(minimum_filter1d(fine, size, axis=0, mode="nearest")[::parts])


def sampled_friction(
    surfaces: Sequence[FrictionLaw | None], motion: Motion, *, dense: float = 80.0
) -> Array:
    """Friction torque of a motion, its step at reversals kept below half of the rate.

    Returns (N, n) [N m; N where prismatic]: before the motion's own low-pass; zero for
    a joint whose friction is not known.
    """
    torque = friction_torque(surfaces, motion.q, motion.dq)
    if motion.rate_hz >= dense * motion.lowpass.cutoff_hz:
        return _warmed(torque, surfaces, motion)
    inside = shrink(motion.valid, HALF + len(KNOTS) // 2)
    for j, surface in enumerate(surfaces):
        if surface is not None:
            near = np.flatnonzero(
                inside & _near_reversals(motion, j, surface.sign_width)
            )
            if near.size:
                torque[near, j] = _band_limited(
                    surface, motion.q[:, j], motion.dq[:, j], near
                )
    return _warmed(torque, surfaces, motion)


def _warmed(
    torque: Array, surfaces: Sequence[FrictionLaw | None], motion: Motion
) -> Array:
    """Friction torque (N, n) N m at the temperatures of the joints, where they were logged."""
    if motion.celsius is None:
        return torque
    for j, surface in enumerate(surfaces):
        if surface is not None and surface.per_kelvin:
            torque[:, j] *= surface.warmed(motion.celsius[:, j])
    return torque


def _near_reversals(motion: Motion, j: int, width: float, *, wide: float = 3.0) -> Mask:
    """Samples (N,) that the low-pass reaches from where a joint is slower than the sign's width."""
    v, moving = motion.dq[:, j], motion.moving[:, j]
    slow = np.abs(v) < wide * width
    turns = (v[1:] * v[:-1] <= 0) | slow[1:] | slow[:-1]
    turns &= moving[1:] & moving[:-1]
    found: Mask = np.zeros(len(v), dtype=np.bool_)
    found[:-1] = turns
    found[1:] |= turns
    return np.asarray(binary_dilation(found, np.ones(2 * HALF + 1, dtype=np.bool_)))


def _band_limited(surface: FrictionLaw, q: Array, dq: Array, near: Index) -> Array:
    """Low-passed friction at samples `near` (M,) of a motion (N,)."""
    used = np.unique(near[:, None] + np.arange(-HALF, HALF + 1))
    q, dq = (x[used[:, None] + KNOTS] @ WEIGHTS for x in (q, dq))
    parts = surface.torque(q.ravel(), dq.ravel()).reshape(len(used), PARTS)
    first = np.searchsorted(used, near)[:, None] + np.arange(-HALF, HALF + 1)
    return np.asarray(np.tensordot(parts[first], _taps(), axes=2))


@lru_cache(maxsize=1)
def _taps(*, beta: float = 7.5) -> Array:
    """Low-pass (2 HALF + 1, PARTS) over the points of the samples around one."""
    taps = np.zeros((2 * HALF + 1) * PARTS)
    taps[: 2 * HALF * PARTS + 1] = firwin(
        2 * HALF * PARTS + 1, 1 / PARTS, window=("kaiser", beta)
    )
    return taps.reshape(2 * HALF + 1, PARTS)
