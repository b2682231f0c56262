"""Torques that echo a command, and are no measurement, while something moves the arm.

Under gravity compensation, or with a constant command, an arm that a hand or its own
weight moves shows a torque that follows position alone. A drive's current that moves a
joint also overcomes its friction and accelerates it. Where a joint moves both ways, the
torque is therefore compared with

    tau = G(q) phi + sum_k c_k T_k(q_j) + F_c tanh(v / v_s) + F_v v + sum_i J_i dv_i/dt,

gravity of the whole arm, a smooth function of the joint's own position, its friction,
and the accelerations of all joints. It is an echo if the first two explain it and the
others have no part, neither in the torque nor in what the first two leave of it, but
for a damping F_v < 0, which no friction has but a controller may. A joint that is only
held is passed over; see `driven`.

A log is not used because of this. So it is not enough that no friction shows: the upper
end of the 95 % interval of F_c must be small beside the torque. Its standard error is
how far the products of what is left with the part of tanh(v / v_s) that no other column
has scatter over stretches of `memory_s`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.distributions import student_quantile
from seqid_cli.inspect.settings import EchoSettings
from seqid_cli.robot.base_parameters import base_parameters, gravity_base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

RCOND = 1e-8
WARNING = (
    "the torque follows the position alone, though the joint moves both ways: it has no"
    " friction and no inertia in it and looks like an echo of the command while a hand,"
    " or gravity, moves the joint"
)
REMEDY = (
    "record the measured motor current while the controller drives the joints along a"
    " trajectory, not gravity compensation and not a constant command; if it is"
    " measured, and the joint hardly rubs, --set echo.max_friction=0 takes the log"
)


def echoes(
    robot: Robot,
    t: Array,
    q: Array,
    tau: Array,
    valid: Mask,
    *,
    settings: EchoSettings = EchoSettings(),
) -> list[int]:
    """Return the joints whose torque follows position alone.

    Parameters
    ----------
    robot : Robot
        The arm, of n joints.
    t : (N,) array
        Times, evenly spaced [s].
    q, tau : (N, n) arrays
        Positions [rad; m] and torques [N m; N].
    valid : (N,) array of bool
        Samples that count.
    settings : EchoSettings
        How much friction an echo may seem to have.
    """
    # Averages over a window take the noise; the residual remembers for `memory_s`.
    window_s = 0.02
    memory_s = 0.5
    # Windows and rad (m) each way: less is noise, or a flexing brake.
    fewest = 50
    travel = 0.1
    # Share of the top speed, below which a joint does not certainly slide.
    slow = 0.05
    most_windows = 4000

    sample_s = float(t[1] - t[0])
    width = max(1, round(window_s / sample_s))
    step = width * sample_s
    q_mean = _window_means(q, width)
    tau_mean = _window_means(tau, width)
    all_valid = _window_means(valid.astype(np.float64), width) == 1.0
    if len(q_mean) < 2 * fewest:
        return []
    v = np.gradient(q_mean, step, axis=0)
    a = np.gradient(v, step, axis=0)

    # A joint is judged where it slides, and moves far enough both ways.
    least_speed = slow * np.quantile(np.abs(v), 0.99, axis=0)
    slides = all_valid & (np.abs(v) > least_speed)
    directions = np.stack([slides & (v > 0), slides & (v < 0)])
    n_windows = directions.sum(axis=1)
    distance = step * (np.abs(v) * directions).sum(axis=1)
    both_ways = ((n_windows >= fewest) & (distance >= travel)).all(axis=0)

    candidates = np.flatnonzero(driven(q_mean) & both_ways).tolist()
    if not candidates:
        return []
    H = gravity_base_regressor(robot, base_parameters(robot, rotor=()), q_mean)
    echoing: list[int] = []
    for j in candidates:
        rows = np.flatnonzero(slides[:, j])
        stride = max(1, len(rows) // most_windows)
        rows = rows[::stride]
        columns = _Columns(
            of_position=np.hstack([H[rows, j], smooth(q_mean[rows, j], 5)]),
            direction=np.tanh(v[rows, j] / least_speed[j]),
            speed=v[rows, j],
            accelerations=a[rows],
        )
        stretch = (rows * step / memory_s).astype(np.intp)
        if _follows_position(tau_mean[rows, j], columns, stretch, settings):
            echoing.append(j)
    return echoing


def _window_means(values: Array, width: int) -> Array:
    """Return means (W, k) over windows of `width` samples of values (N, k) or (N,)."""
    count = len(values) // width
    windows = values[: count * width].reshape(count, width, -1)
    return np.asarray(windows.mean(axis=1))


def smooth(q: Array, terms: int) -> Array:
    """Return Chebyshev polynomials (N, terms) over the range of positions (N,)."""
    place = 2.0 * (q - q.min()) / max(float(np.ptp(q)), 1e-12) - 1.0
    return np.asarray(chebvander(place, terms - 1))


def driven(
    q: Array, *, held: float = 0.1, middle: tuple[float, float] = (0.01, 0.99)
) -> Mask:
    """Return which joints (n,) of positions (N, n) are driven on a way of their own.

    The others are held, and other joints shake them. In closed loop with a constant
    reference such a joint's torque is its controller's law, -k_p (q - q_0) - k_d dq,
    whatever its friction (Forssell and Ljung, Closed-loop identification revisited,
    Automatica 35(7), 1999).

    Parameters
    ----------
    q : (N, n) array
        Positions [rad; m].
    held : float
        Share of the farthest joint's travel, below which a joint is held.
    middle : (float, float)
        Quantiles between which a joint travels.
    """
    low, high = np.nanquantile(q, middle, axis=0)
    return np.asarray(high - low >= held * np.max(high - low))


@dataclass(frozen=True)
class _Columns:
    """Terms of a joint's torque at M windows."""

    of_position: Array  # (M, k)
    direction: Array  # (M,)
    speed: Array  # (M,)
    accelerations: Array  # (M, n)


def _follows_position(
    tau: Array, columns: _Columns, stretch: Index, settings: EchoSettings
) -> bool:
    """Return whether position alone makes a torque (M,).

    `stretch` (M,) numbers the stretches of time that residuals remember, ascending.
    """
    # Shares of the torque's RMS: that may be left; with nothing to explain.
    unexplained = 0.1
    exact = 1e-3
    # Share of what position leaves, squared, for friction and accelerations.
    others = 0.15

    size = max(float(np.sqrt(np.mean(tau**2))), 1e-300)
    friction = np.stack([columns.direction, columns.speed], axis=1)
    X = np.hstack([columns.of_position, friction, columns.accelerations])
    X = X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
    direction_column = columns.of_position.shape[1]
    speed_column = direction_column + 1
    theta = np.linalg.lstsq(X, tau, rcond=RCOND)[0]
    left = tau - X @ theta
    mean_square = float(np.mean(left**2))

    # Damping by a controller is no friction: it counts as a part of the law.
    law = list(range(direction_column))
    if theta[speed_column] < 0:
        law.append(speed_column)
    rms_beside_law = float(np.sqrt(np.mean(_residual(X[:, law], tau) ** 2)))
    share_of_others = 1.0 - mean_square / max(rms_beside_law**2, 1e-300)
    if rms_beside_law >= unexplained * size:
        return False
    if share_of_others >= others and rms_beside_law >= exact * size:
        return False

    # Only what of the direction the other columns do not show determines its friction.
    other_columns = np.delete(X, direction_column, axis=1)
    direction = _residual(other_columns, X[:, direction_column])
    std_error = _std_error(direction, left, stretch)
    n_stretches = len(np.unique(stretch))
    quantile = student_quantile(n_stretches - 1, 0.975)
    largest = abs(float(theta[direction_column])) + quantile * std_error
    return largest < settings.max_friction * size


def _std_error(column: Array, left: Array, stretch: Index) -> float:
    """Return the standard error of a coefficient.

    Parameters
    ----------
    column : (M,) array
        The part of its column that no other column has.
    left : (M,) array
        What all columns leave.
    stretch : (M,) index array
        Stretches of time, within which residuals remember; infinite with one of them.
    """
    _, number = np.unique(stretch, return_inverse=True)
    sums = np.bincount(number, weights=column * left)
    count = len(sums)
    if count < 2:
        return float("inf")
    scatter = float(np.sqrt(count / (count - 1) * np.sum(sums**2)))
    return scatter / max(float(column @ column), 1e-300)


def _residual(X: Array, y: Array) -> Array:
    """Return what the columns X leave of y."""
    return np.asarray(y - X @ np.linalg.lstsq(X, y, rcond=RCOND)[0])
