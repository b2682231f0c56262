"""Torque against motion: friction must brake, whatever the inertias are.

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
from typing import Any, NamedTuple

import numpy as np

from seqid_cli.inspect.dynamics.echo import driven, smooth
from seqid_cli.inspect.findings import finding_of
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
from seqid_cli.spectra import correlated
from seqid_cli.typing import Mask

SIGMAS = 4.0
SHARE = 0.03  # of the torque's spread, that friction must be to be judged
SMOOTH_TERMS = 4


@dataclass(frozen=True, kw_only=True)
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
    # Of the robot without rotors; None where its geometry is not known.
    basis: Basis | None
    # RMS (n,) of which errors are shares; None where it is that of `tau`.
    sizes: Array | None = None

    def mapped(self, change: Callable[[Array], Array]) -> "Sample":
        """Return the sample with every array changed alike."""
        names = ("q", "dq", "ddq", "tau", "direction")
        changed: dict[str, Any] = {name: change(getattr(self, name)) for name in names}
        return replace(self, **changed)

    def thinned(self, count: int = 600) -> "Sample":
        """Return about `count` rows, for a fit of all joints at once."""
        stride = max(1, len(self.q) // count)
        thin = self.mapped(lambda values: values[::stride])
        return replace(thin, memory=max(1.0, self.memory / stride))

    @property
    def rms_speeds(self) -> Array:
        """RMS speeds of the joints (n,), rad/s (m/s)."""
        return _rms_speeds(self.dq)

    def gravity_columns(self) -> Array:
        """Return gravity torques (N, n, g) per parameter; g is 0 where unknown."""
        if self.basis is None or not self.robot.gravity.any():
            return np.zeros((*self.q.shape, 0))
        return gravity_base_regressor(self.robot, self.basis, self.q)

    def friction_columns(self) -> Array:
        """Return columns (N, n, 4) of one joint each: offset, rotor, direction, speed.

        Of a joint that does not move all but the offset are zero.
        """
        moves = np.isin(np.arange(self.robot.n), self.moving)[:, None]
        of_motion = np.stack([self.ddq, self.direction, self.dq], axis=-1)
        offset = np.ones((*self.q.shape, 1))
        return np.concatenate([offset, np.where(moves, of_motion, 0.0)], axis=2)

    def nominal(self) -> tuple[Array, Array]:
        """Return gravity and inertia torques (N, n) by the URDF's inertials."""
        robot = self.robot
        assert robot.nominal is not None
        still = np.zeros_like(self.q)
        gravity = inverse_dynamics(
            robot.chain, robot.gravity, robot.nominal, self.q, still, still
        )
        total = inverse_dynamics(
            robot.chain, robot.gravity, robot.nominal, self.q, self.dq, self.ddq
        )
        return gravity, total - gravity


def _rms_speeds(dq: Array) -> Array:
    """Return the RMS (n,) of speeds (N, n), never quite zero."""
    return np.asarray(np.maximum(np.sqrt(np.mean(dq**2, axis=0)), 1e-12))


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
    """Filter a log.

    Parameters
    ----------
    data : LogData
        The log.
    max_rows, min_rows : int
        Rows that are kept, and those that a sample has at least.
    slow : float
        Share of the RMS speed over which friction changes its sign.
    memory_s : float
        Time whose rows count as one [s].
    min_way : float
        Way [rad; m] that a joint moves at least each way, to be judged.
    min_balance : float
        The same as a share of the longer way.

    Returns
    -------
    Sample or None
        None where the log has no torque, or nothing moves long enough.
    """
    if data.recording.tau is None or data.motion is None:
        return None
    motion = decimated(data.motion)
    rows = np.flatnonzero(motion.usable & np.isfinite(motion.dq).all(axis=1))
    rows = rows[:: max(1, len(rows) // max_rows)]
    if len(rows) < min_rows or motion.tau is None:
        return None

    q = motion.q[rows]
    dq = motion.dq[rows]
    interval_s = float(np.median(np.diff(motion.t[rows])))
    moving = _driven_both_ways(
        data, q, dq, interval_s, min_way=min_way, min_balance=min_balance
    )
    direction = np.tanh(motion.dq / (slow * _rms_speeds(dq)))
    knows_geometry = data.modelled and bool(moving)
    return Sample(
        robot=data.robot,
        q=q,
        dq=dq,
        ddq=motion.ddq[rows],
        tau=motion.tau[rows],
        direction=motion.filtered(direction, 2)[rows],
        memory=max(1.0, memory_s / interval_s),
        moving=moving,
        basis=base_parameters(data.robot, rotor=()) if knows_geometry else None,
    )


def _driven_both_ways(
    data: LogData,
    q: Array,
    dq: Array,
    interval_s: float,
    *,
    min_way: float,
    min_balance: float,
) -> tuple[int, ...]:
    """Return the joints that are driven far enough both ways.

    `q`, `dq` (N, n) are positions and velocities of rows, `interval_s` apart.
    """
    forward = np.clip(dq, 0.0, None).sum(axis=0) * interval_s
    backward = np.clip(-dq, 0.0, None).sum(axis=0) * interval_s
    shorter = np.minimum(forward, backward)
    longer = np.maximum(forward, backward)
    both_ways = shorter > np.maximum(min_way, min_balance * longer)
    candidates = np.flatnonzero(driven(q) & both_ways).tolist()
    return tuple(j for j in candidates if data.moves(j))


class _JointFriction(NamedTuple):
    """Friction of all moving joints in the torque of one joint.

    `values` and `std_errors` (n,) N m at each joint's RMS speed are NaN for joints that
    do not move. `spread` [N m] is the torque's, `unexplained` the share of it that is
    left.
    """

    values: Array
    std_errors: Array
    spread: float
    unexplained: float


def friction_findings(
    data: LogData, sample: Sample, *, max_unexplained: float = 0.25
) -> Iterator[InspectionFinding]:
    """Check signs of torques and their order by the friction that they show.

    Parameters
    ----------
    data : LogData
        The log.
    sample : Sample
        Its filtered motion and torque.
    max_unexplained : float
        Share of a torque's spread above which nothing is said of a robot whose geometry
        is not known: gravity of unknown links could pass for anything.
    """
    names = data.robot.joint_names
    gravity = sample.gravity_columns()
    fits = [_friction(sample, gravity[:, j], j) for j in range(data.robot.n)]
    swapped = _exchanged(fits, sample.moving)
    for a, b in swapped:
        text = (
            f"the torque of {names[a]} is friction of {names[b]}, not of its own motion"
        )
        yield finding_of("joints_swapped", text, f"{names[a]}, {names[b]}", "torque")

    for j in sample.moving:
        fit = fits[j]
        is_unknown = not data.modelled and fit.unexplained > max_unexplained
        if is_unknown or any(j in pair for pair in swapped):
            continue
        value = fit.values[j]
        std_error = fit.std_errors[j]
        if value < -SIGMAS * std_error and value < -SHARE * fit.spread:
            joint = data.robot.joints[j]
            text = (
                f"its friction is {value:.3g} +- {std_error:.2g} {joint.unit('N m')} at"
                f" {sample.rms_speeds[j]:.3g} {joint.unit('rad/s')}: the joint would"
                " gain energy"
            )
            yield finding_of("sign_mismatch", text, names[j], "torque")


class ScaledFit(NamedTuple):
    """Least squares of y (N,): theta (p,), the map (p, N) from y, the residual (N,)."""

    theta: Array
    inverse: Array
    residual: Array


def scaled_fit(X: Array, y: Array, *, rcond: float = 1e-8) -> ScaledFit:
    """Fit y (N,) by columns X (N, p), which are scaled to one size."""
    scale = _sizes(X)
    inverse = np.linalg.pinv(X / scale, rcond=rcond) / scale[:, None]
    theta = inverse @ y
    return ScaledFit(theta=theta, inverse=inverse, residual=y - X @ theta)


def scaled_residual(X: Array, y: Array, *, rcond: float = 1e-8) -> Array:
    """Return what `scaled_fit` leaves (N,), without the map from y.

    Searches ask for it hundreds of times.
    """
    scaled = X / _sizes(X)
    theta = np.linalg.lstsq(scaled, y, rcond=rcond)[0]
    return np.asarray(y - scaled @ theta)


def _sizes(X: Array) -> Array:
    """Return the RMS (p,) of columns (N, p), never quite zero."""
    return np.asarray(np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12))


def _friction(sample: Sample, gravity: Array, j: int) -> _JointFriction:
    """Fit the torque of joint `j`; `gravity` (N, g) are its columns of gravity."""
    tau = sample.tau[:, j]
    moving = list(sample.moving)
    values = np.full(sample.robot.n, np.nan)
    std_errors = np.full(sample.robot.n, np.nan)
    spread = float(tau.std())
    if spread == 0.0 or not moving:
        return _JointFriction(values, std_errors, spread, np.nan)

    columns = [*sample.direction[:, moving].T, *sample.ddq[:, moving].T]
    if j in moving:
        # Beside viscous friction less the direction, the coefficient of the direction
        # is all friction at the RMS speed.
        relative_speed = sample.dq[:, j] / sample.rms_speeds[j]
        columns.append(relative_speed - sample.direction[:, j])
    # What depends on position alone: a smooth function of the joint's own, and gravity.
    of_position = smooth(sample.q[:, j], SMOOTH_TERMS if j in sample.moving else 1)
    heavy = [column for column in gravity.T if np.abs(column).max() > 1e-9]
    X = np.column_stack([*columns, of_position, *heavy])
    fit = scaled_fit(X, tau)

    memory = max(sample.memory, memory_of(fit.residual))
    freedom = max(len(tau) - len(fit.theta) * sample.memory, 10.0)
    variance = float(fit.residual @ fit.residual) / freedom * memory
    count = len(moving)
    values[moving] = fit.theta[:count]
    std_errors[moving] = np.sqrt(np.sum(fit.inverse**2, axis=1) * variance)[:count]
    rms_residual = float(np.sqrt(np.mean(fit.residual**2)))
    return _JointFriction(values, std_errors, spread, rms_residual / spread)


def memory_of(residual: Array) -> float:
    """Return how many rows of a residual say as much as one, by its autocorrelation."""
    x = residual - residual.mean()
    r = correlated(x, x)[len(x) - 1 :]
    # Beyond its first zero the autocorrelation is noise.
    not_positive = np.flatnonzero(r <= 0.0)
    last = not_positive[0] if len(not_positive) else len(r)
    return float(1.0 + 2.0 * r[1:last].sum() / max(r[0], 1e-300))


def _exchanged(
    fits: list[_JointFriction],
    moving: tuple[int, ...],
    *,
    max_own: float = 0.25,
) -> list[tuple[int, int]]:
    """Return pairs of joints whose torques show each other's friction only."""
    friction = np.array([fit.values for fit in fits])
    std_errors = np.array([fit.std_errors for fit in fits])
    spreads = np.array([fit.spread for fit in fits])
    by_itself = np.abs(np.diag(friction))
    own_error = 2.0 * np.diag(std_errors)

    # Row: the joint of the torque; column: the joint of the motion.
    least = np.maximum(SIGMAS * std_errors, SHARE * spreads[:, None])
    is_there = friction > np.maximum(least, own_error)
    own_is_not = by_itself < np.maximum(max_own * friction, own_error)
    is_alien = is_there & own_is_not
    # The motion of a joint that stands shows nowhere.
    stands: Mask = ~np.isin(np.arange(len(by_itself)), moving)
    fits_other = is_alien | stands
    return [
        (a, b)
        for a, b in combinations(range(len(by_itself)), 2)
        if fits_other[a, b] and fits_other[b, a] and not (stands[a] and stands[b])
    ]
