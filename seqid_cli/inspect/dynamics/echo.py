"""Whether a log's torque is measured, or an echo of the command while something else moves the arm.

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
"""

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.robot.base_parameters import base_parameters, gravity_base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

RCOND = 1e-8
WARNING = (
    "the torque follows the position alone, though the joint moves both ways: it has no"
    " friction and no inertia in it and looks like an echo of the command while a hand,"
    " or gravity, moves the joint"
)
REMEDY = (
    "record the measured motor current while the controller drives the joints along a"
    " trajectory, not gravity compensation and not a constant command"
)


def echoes(robot: Robot, t: Array, q: Array, tau: Array, valid: Mask) -> list[int]:
    """Return the joints whose torque follows position alone, of the samples `valid`.

    `t`, `q`, `tau` (N,) (N, n) (N, n): s, rad (m), N m (N).
    """
    window_s, memory_s = 0.02, 0.5  # of averages, of the residual
    # windows and rad (m) each way: less is noise, or a flexing brake
    fewest, travel = 50, 0.1
    slow = 0.05  # share of the top speed, below which a joint does not certainly slide
    most_windows = 4000
    width = max(1, round(window_s / float(t[1] - t[0])))
    step, count = width * float(t[1] - t[0]), len(q) // width
    parts = (
        x[: count * width].reshape(count, width, -1) for x in (q, tau, valid * 1.0)
    )
    Q, T, whole = (part.mean(axis=1) for part in parts)
    if len(Q) < 2 * fewest:
        return []
    v = np.gradient(Q, step, axis=0)
    a = np.gradient(v, step, axis=0)
    H = gravity_base_regressor(robot, base_parameters(robot, rotor=()), Q)
    least = slow * np.quantile(np.abs(v), 0.99, axis=0)
    slides = (whole == 1.0) & (np.abs(v) > least)
    ways = np.stack([slides & (v > 0), slides & (v < 0)])
    enough = (ways.sum(axis=1) >= fewest) & (
        step * (np.abs(v) * ways).sum(axis=1) >= travel
    )
    found: list[int] = []
    for j in np.flatnonzero(driven(Q) & enough.all(axis=0)).tolist():
        at = np.flatnonzero(slides[:, j])
        at = at[:: max(1, len(at) // most_windows)]
        friction = np.stack([np.tanh(v[at, j] / least[j]), v[at, j]], axis=1)
        law = np.hstack([H[at, j], smooth(Q[at, j], 5)])
        if _follows(T[at, j], law, friction, a[at], memory_s / step):
            found.append(j)
    return found


def smooth(q: Array, terms: int) -> Array:
    """Chebyshev polynomials (N, terms) over the range of positions (N,)."""
    place = 2.0 * (q - q.min()) / max(float(np.ptp(q)), 1e-12) - 1.0
    return np.asarray(chebvander(place, terms - 1))


def driven(
    q: Array, *, held: float = 0.1, middle: tuple[float, float] = (0.01, 0.99)
) -> Mask:
    """Which joints (n,) of positions (N, n) are driven on a way of their own.

    The others are held, and other joints shake them. In closed loop with a constant
    reference such a joint's torque is its controller's law, -k_p (q - q_0) - k_d dq,
    whatever its friction (Forssell and Ljung, Closed-loop identification revisited,
    Automatica 35(7), 1999). A joint is held below a share `held` of the farthest one's
    travel between the `middle` quantiles.
    """
    low, high = np.nanquantile(q, middle, axis=0)
    return np.asarray(high - low >= held * np.max(high - low))


def _follows(
    y: Array, law: Array, friction: Array, accelerations: Array, memory: float
) -> bool:
    """Whether position alone makes a torque y (M,); `memory` is how many samples count as one."""
    # Shares of the torque's RMS: that may be left; with nothing to explain; that is no
    # friction.
    unexplained, exact, none = 0.1, 1e-3, 0.003
    # share of what position leaves, squared, for friction and accelerations
    others = 0.15
    uncertain = 2.0  # standard errors of the friction
    scale = max(float(np.sqrt(np.mean(y**2))), 1e-300)
    X = np.hstack([law, friction, accelerations])
    X = X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
    own = law.shape[1]  # where the direction stands
    theta = np.linalg.lstsq(X, y, rcond=RCOND)[0]
    direction = _beside(np.delete(X, own, axis=1), X[:, own])
    # damping by a controller, not friction
    held_back = [own + 1] if theta[own + 1] < 0 else []
    left = float(np.mean((y - X @ theta) ** 2))
    rest = float(np.sqrt(np.mean(_beside(X[:, [*range(own), *held_back]], y) ** 2)))
    part = 1.0 - left / max(rest**2, 1e-300)  # friction's and accelerations'
    error = float(np.sqrt(memory * left / max(float(direction @ direction), 1e-300)))
    alone = rest < unexplained * scale and (part < others or rest < exact * scale)
    return alone and abs(float(theta[own])) < max(uncertain * error, none * scale)


def _beside(X: Array, y: Array) -> Array:
    """What the columns X leave of y."""
    return np.asarray(y - X @ np.linalg.lstsq(X, y, rcond=RCOND)[0])
