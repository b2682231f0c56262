"""Whether a log's torque is measured, or an echo of the command while something else moves the arm.

Under gravity compensation, or with a constant command, an arm that a hand or its own weight moves
shows a torque that follows position alone. A drive's current that moves a joint also overcomes its
friction and accelerates it. Where a joint moves both ways, the torque of a log is therefore
compared with

    tau = G(q) phi + sum_k c_k T_k(q_j) + F_c tanh(v / v_s) + F_v v + sum_i J_i dv_i/dt,

gravity of the whole arm, a smooth function of the joint's own position, its friction, and the
accelerations of all joints. It is an echo if the first two explain it and the others have no part,
neither in the torque nor in what the first two leave of it, but for a damping F_v < 0, which no
friction has but a controller may. A joint that is only held is passed over: while others shake it,
its torque follows its position by its controller's law.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

RCOND = 1e-8

WARNING = (
    "the torque follows the position alone, though the joint moves both ways: it has no friction "
    "and no inertia in it and looks like an echo of the command while a hand, or gravity, moves "
    "the joint"
)
REMEDY = (
    "record the measured motor current while the controller drives the joints along a trajectory, "
    "not gravity compensation and not a constant command"
)


@dataclass(frozen=True)
class EchoCriteria:
    """When a torque is an echo of the command. Shares are of the torque's RMS."""

    unexplained: float = 0.1  # that an echo's law may leave
    exact: float = 1e-3  # below it nothing is left to be explained
    others: float = 0.15  # of what position leaves, squared, for friction and acceleration
    none: float = 0.003  # that is no friction at all
    uncertain: float = 2.0  # standard errors
    fewest: int = 50  # windows of motion each way
    travel: float = 0.1  # rad (m) each way: less is noise, or a flexing brake
    slow: float = 0.05  # of the top speed, below which a joint does not certainly slide
    window_s: float = 0.02  # over which samples are averaged
    memory_s: float = 0.5  # that the residual remembers, for the errors
    most_windows: int = 4000  # of a joint that are used
    smooth_terms: int = 5  # of a smooth function of its position


CRITERIA = EchoCriteria()


def echoes(robot: Robot, t: Array, q: Array, tau: Array, valid: Mask) -> list[int]:
    """Return the joints whose torque follows position alone.

    `t`, `q`, `tau` (N,) (N, n) (N, n): s, rad (m), N m (N). `valid` (N,): samples to look at.
    """
    width = max(1, round(CRITERIA.window_s / float(t[1] - t[0])))
    count = len(q) // width
    Q, T, whole = (
        x[: count * width].reshape(count, width, -1).mean(axis=1) for x in (q, tau, valid * 1.0)
    )
    if len(Q) < 2 * CRITERIA.fewest:
        return []
    step = width * float(t[1] - t[0])
    v = np.gradient(Q, step, axis=0)
    a = np.gradient(v, step, axis=0)
    still = np.zeros_like(Q)
    H = base_regressor(robot, base_parameters(robot, rotor=[]), Q, still, still)
    H = H[:, :, H.any(axis=(0, 1))]
    found: list[int] = []
    for j in np.flatnonzero(driven(Q)).tolist():
        top = float(np.quantile(np.abs(v[:, j]), 0.99))
        slides = (whole[:, 0] == 1.0) & (np.abs(v[:, j]) > CRITERIA.slow * top)
        ways = [np.abs(v[slides & (way * v[:, j] > 0), j]) for way in (1, -1)]
        if min(map(len, ways)) < CRITERIA.fewest:
            continue
        if min(float(own.sum()) for own in ways) * step < CRITERIA.travel:
            continue
        at = np.flatnonzero(slides)
        at = at[:: max(1, len(at) // CRITERIA.most_windows)]
        friction = np.stack([np.tanh(v[at, j] / (CRITERIA.slow * top)), v[at, j]], axis=1)
        own = Q[at, j]
        place = 2 * (own - own.min()) / (float(np.ptp(own)) or 1.0) - 1
        law = np.hstack([H[at, j], chebvander(place, CRITERIA.smooth_terms - 1)])
        if _follows(T[at, j], law, friction, a[at], CRITERIA.memory_s / step):
            found.append(j)
    return found


def driven(q: Array, *, held: float = 0.1, middle: tuple[float, float] = (0.01, 0.99)) -> Mask:
    """Which joints (n,) are driven on a way of their own.

    The others are held, and the moves of other joints shake them. In closed loop with a constant
    reference such a joint's torque is its controller's law, -k_p (q - q_0) - k_d dq, whatever its
    friction: nothing about friction can be told from it (Forssell and Ljung, Closed-loop
    identification revisited, Automatica 35(7), 1999).

    `q` (N, n): positions, rad (m), between whose `middle` quantiles a joint travels. `held`: share
    of the farthest joint's travel, below which a joint is held.
    """
    low, high = np.nanquantile(q, middle, axis=0)
    return np.asarray(high - low >= held * np.max(high - low))


def _follows(y: Array, law: Array, friction: Array, accelerations: Array, memory: float) -> bool:
    """Whether position alone makes a torque y (M,); `memory` is how many samples count as one."""
    scale = max(float(np.sqrt(np.mean(y**2))), 1e-300)
    X = np.hstack([law, friction, accelerations])
    X = X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
    own = law.shape[1]  # where the direction stands
    theta = np.linalg.lstsq(X, y, rcond=RCOND)[0]
    direction = _beside(np.delete(X, own, axis=1), X[:, own])
    held_back = [own + 1] if theta[own + 1] < 0 else []  # damping by a controller, not friction
    left = float(np.mean((y - X @ theta) ** 2))
    unexplained = float(np.sqrt(np.mean(_beside(X[:, [*range(own), *held_back]], y) ** 2)))
    others = 1.0 - left / max(unexplained**2, 1e-300)  # friction's and accelerations'
    error = float(np.sqrt(memory * left / max(float(direction @ direction), 1e-300))) / scale
    return (
        unexplained / scale < CRITERIA.unexplained
        and (others < CRITERIA.others or unexplained / scale < CRITERIA.exact)
        and abs(float(theta[own])) / scale < max(CRITERIA.uncertain * error, CRITERIA.none)
    )


def _beside(X: Array, y: Array) -> Array:
    """What the columns X leave of y."""
    return np.asarray(y - X @ np.linalg.lstsq(X, y, rcond=RCOND)[0])
