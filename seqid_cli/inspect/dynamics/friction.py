"""Torque against motion: friction must brake, and the rigid-body equations must fit.

For every joint j the filtered torque is compared with

    tau_j = G_j(q) phi + sum_k c_k T_k(q_j) + sum_i J_i ddq_i + sum_i F_i tanh(dq_i /
    v_i) + B dq_j,

gravity of the whole arm, a smooth function of the joint's own position, accelerations,
and friction of every joint that moves. Whatever the inertias are, F_j tanh + B dq at
the joint's own RMS speed is positive: a negative one means that torque and position
have opposite signs. If F_i of another joint i is there and the joint's own is not, the
torque is that of the other joint.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.signal import correlate

from seqid_cli.inspect.dynamics.echo import driven, smooth
from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.motion.motion import decimated
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.base_parameters import (
    Basis,
    base_parameters,
    gravity_base_regressor,
)
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot

SIGMAS = 4.0
SHARE = 0.03  # of the torque's spread, that friction must be to be judged
SMOOTH_TERMS = 4


@dataclass(frozen=True)
class Sample:
    """Filtered motion and torque of a log at the rows that count, all (N, n)."""

    robot: Robot
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    direction: Array  # of motion, -1 to 1, through the torque's filter
    memory: float  # rows that count as one
    moving: tuple[int, ...]  # joints that are driven far enough both ways
    # of the robot without rotors; None where its geometry is not known
    basis: Basis | None

    def mapped(self, change: Callable[[Array], Array]) -> "Sample":
        """Change every array alike."""
        names = ("q", "dq", "ddq", "tau", "direction")
        changed: dict[str, Any] = {name: change(getattr(self, name)) for name in names}
        return replace(self, **changed)

    def thinned(self, count: int = 600) -> "Sample":
        """Keep about `count` rows, for a fit of all joints at once."""
        every = max(1, len(self.q) // count)
        few = self.mapped(lambda values: values[::every])
        return replace(few, memory=max(1.0, self.memory / every))

    @property
    def rms_speeds(self) -> Array:
        """RMS speed of each joint (n,), rad/s."""
        return np.asarray(np.maximum(np.sqrt(np.mean(self.dq**2, axis=0)), 1e-12))

    def gravity_columns(self) -> Array:
        """Gravity torque (N, n, g) of its parameters, none where it is not known."""
        if self.basis is None or not self.robot.gravity.any():
            return np.zeros((*self.q.shape, 0))
        return gravity_base_regressor(self.robot, self.basis, self.q)

    def own_columns(self) -> Array:
        """Columns (N, n, 4) of one joint each: offset, rotor, direction and speed."""
        moves = np.isin(np.arange(self.robot.n), self.moving)[:, None]
        own = np.where(
            moves, np.stack([self.ddq, self.direction, self.dq], axis=-1), 0.0
        )
        return np.concatenate([np.ones((*self.q.shape, 1)), own], axis=2)

    def nominal(self) -> tuple[Array, Array]:
        """Gravity and inertia torque (N, n) by the URDF's inertials."""
        robot, still = self.robot, np.zeros_like(self.q)
        assert robot.nominal is not None
        given = robot.chain, robot.gravity, robot.nominal, self.q
        gravity = inverse_dynamics(*given, still, still)
        return gravity, inverse_dynamics(*given, self.dq, self.ddq) - gravity


def sample_of(
    data: LogData,
    *,
    max_rows: int = 1000,
    min_rows: int = 60,
    slow: float = 0.1,
    memory_s: float = 0.3,
    min_way: float = 0.05,
    min_balance: float = 0.2,
) -> Sample | None:
    """Filter a log; None where it has no torque or nothing moves long enough."""
    if data.recording.tau is None or data.motion is None:
        return None
    motion = decimated(data.motion)
    rows = np.flatnonzero(motion.usable & np.isfinite(motion.dq).all(axis=1))
    rows = rows[:: max(1, len(rows) // max_rows)]
    if len(rows) < min_rows or motion.tau is None:
        return None
    q, dq, spacing = (
        motion.q[rows],
        motion.dq[rows],
        float(np.median(np.diff(motion.t[rows]))),
    )
    ways = np.array(
        [np.clip(sign * dq, 0.0, None).sum(axis=0) * spacing for sign in (1.0, -1.0)]
    )
    both_ways = ways.min(axis=0) > np.maximum(min_way, min_balance * ways.max(axis=0))
    moving = tuple(
        j for j in np.flatnonzero(driven(q) & both_ways).tolist() if data.moves(j)
    )
    speeds = np.maximum(np.sqrt(np.mean(dq**2, axis=0)), 1e-12)
    direction = motion.filtered(np.tanh(motion.dq / (slow * speeds)), 2)[rows]
    basis = base_parameters(data.robot, rotor=()) if data.modelled and moving else None
    ddq, tau, memory = motion.ddq[rows], motion.tau[rows], max(1.0, memory_s / spacing)
    return Sample(data.robot, q, dq, ddq, tau, direction, memory, moving, basis)


def friction_findings(
    data: LogData, sample: Sample, *, max_unexplained: float = 0.25
) -> Iterator[InspectionFinding]:
    """Check signs of torques and their order by the friction that they show."""
    names, gravity = data.robot.joint_names, sample.gravity_columns()
    fits = [_friction(sample, gravity[:, j], j) for j in range(data.robot.n)]
    friction, errors, spread, unexplained = map(np.array, zip(*fits, strict=True))
    swapped = _exchanged(friction, errors, spread, sample.moving)
    for a, b in swapped:
        text = (
            f"the torque of {names[a]} is friction of {names[b]}, not of its own motion"
        )
        yield found("joints_swapped", text, f"{names[a]}, {names[b]}", "torque")
    for j in sample.moving:
        unknown = not data.modelled and unexplained[j] > max_unexplained
        if unknown or any(j in pair for pair in swapped):
            continue  # gravity of unknown links could pass for anything
        value, error = friction[j, j], errors[j, j]
        if value < -SIGMAS * error and value < -SHARE * spread[j]:
            unit = data.robot.joints[j].unit
            text = f"its friction is {value:.3g} +- {error:.2g} {unit('N m')} at "
            text += (
                f"{sample.rms_speeds[j]:.3g} {unit('rad/s')}: the joint would gain"
                " energy"
            )
            yield found("sign_mismatch", text, names[j], "torque")


def scaled_fit(
    X: Array, y: Array, *, rcond: float = 1e-8
) -> tuple[Array, Array, Array]:
    """Least squares of y (N,) by columns X (N, p), scaled: theta, map from y, what is left."""
    scale = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
    inverse = np.linalg.pinv(X / scale, rcond=rcond) / scale[:, None]
    theta = inverse @ y
    return theta, inverse, y - X @ theta


def _friction(
    sample: Sample, gravity: Array, j: int
) -> tuple[Array, Array, float, float]:
    """Friction of every moving joint (n,) in a torque or NaN, errors, its spread, what is left."""
    tau, moving = sample.tau[:, j], list(sample.moving)
    spread, (friction, errors) = float(tau.std()), np.full((2, sample.robot.n), np.nan)
    if spread == 0.0 or not moving:
        return friction, errors, spread, np.nan
    columns = [*sample.direction[:, moving].T, *sample.ddq[:, moving].T]
    # beside it, the coefficient of the direction is friction at RMS speed
    if j in moving:
        columns.append(sample.dq[:, j] / sample.rms_speeds[j] - sample.direction[:, j])
    # What depends on position alone: a smooth function of its own, and gravity.
    own = smooth(sample.q[:, j], SMOOTH_TERMS if j in sample.moving else 1)
    heavy = [g for g in gravity.T if np.abs(g).max() > 1e-9]
    theta, inverse, residual = scaled_fit(np.column_stack([*columns, own, *heavy]), tau)
    freedom = max(len(tau) - len(theta) * sample.memory, 10.0)
    # How many samples of the residual say as much as one: by its autocorrelation.
    x = residual - residual.mean()
    r = correlate(x, x, method="fft")[len(x) - 1 :]
    last = next(iter(np.flatnonzero(r <= 0.0)), len(r))
    memory = float(1.0 + 2.0 * r[1:last].sum() / max(r[0], 1e-300))
    variance = float(residual @ residual) / freedom * max(sample.memory, memory)
    friction[moving] = theta[: len(moving)]
    errors[moving] = np.sqrt(np.sum(inverse**2, axis=1) * variance)[: len(moving)]
    return friction, errors, spread, float(np.sqrt(np.mean(residual**2))) / spread


def _exchanged(
    friction: Array,
    errors: Array,
    spread: Array,
    moving: tuple[int, ...],
    *,
    max_own: float = 0.25,
) -> list[tuple[int, int]]:
    """Pairs of joints whose torques show each other's friction (n, n) but not their own."""
    own, own_error = np.abs(np.diag(friction)), 2.0 * np.diag(errors)
    least = np.maximum(np.maximum(SIGMAS * errors, SHARE * spread[:, None]), own_error)
    alien = (friction > least) & (own < np.maximum(max_own * friction, own_error))
    still = ~np.isin(np.arange(len(own)), moving)
    fits = alien | still  # whose motion shows nowhere
    pairs = combinations(range(len(own)), 2)
    return [
        (a, b)
        for a, b in pairs
        if fits[a, b] and fits[b, a] and not (still[a] and still[b])
    ]
