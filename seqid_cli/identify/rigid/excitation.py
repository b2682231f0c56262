"""Which pairs of joints must move together to determine what is still open (Sec. 2.2.4)."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from seqid_cli.robot.base_parameters import Basis, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def missing_pairs(robot: Robot, basis: Basis, left_open: Array) -> list[list[str]]:
    """Choose pairs greedily until every base parameter is seen, and none that the others make idle.

    `left_open` (b, k): directions of the base parameters that are not determined yet. Returns:
    empty where no pair would add anything; each pair once. An arm of one joint has that alone.
    """
    candidates = list(combinations(range(robot.n), 2)) or [(0, 0)]
    seen = {pair: _pair_regressor(robot, basis, pair) for pair in candidates}
    scale = np.max([np.linalg.norm(H, axis=0) for H in seen.values()], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    seen = {pair: H / scale for pair, H in seen.items()}
    first = left = np.asarray(np.linalg.qr(scale[:, None] * left_open)[0])
    chosen: list[tuple[int, int]] = []
    while left.shape[1]:
        after = {pair: _still_open(H, left) for pair, H in seen.items()}
        best = min(after, key=lambda pair: after[pair].shape[1])
        if after[best].shape[1] == left.shape[1]:
            break
        chosen.append(best)
        left = after[best]
    needed = _without_idle([seen[pair] for pair in chosen], first, left.shape[1])
    return [[robot.joint_names[j] for j in dict.fromkeys(chosen[k])] for k in needed]


def _without_idle(seen: Sequence[Array], left: Array, most: int) -> list[int]:
    """Which of the regressors, together, leave no more than `most` of the directions open."""
    kept = list(range(len(seen)))
    for k in range(len(seen)):
        others = [seen[i] for i in kept if i != k]
        if others and _still_open(np.vstack(others), left).shape[1] <= most:
            kept.remove(k)
    return kept


def _pair_regressor(
    robot: Robot, basis: Basis, pair: tuple[int, int], *, states: int = 120
) -> Array:
    """Rows of the two moving joints in random states with all others locked at random angles."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.5, 2.5, (states, robot.n))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    moving = list(pair)
    dq[:, moving] = rng.normal(size=(states, 2))
    ddq[:, moving] = 3 * rng.normal(size=(states, 2))
    H = base_regressor(robot, basis, q, dq, ddq)[:, moving]
    return H.reshape(-1, basis.size)


def _still_open(H: Array, left: Array, *, min_share: float = 1e-6) -> Array:
    """The part of the directions `left` (b, k), orthonormal, that rows H (N, b) do not see."""
    # Singular values below `min_share` of the largest are rounding.
    _, s, Vt = np.linalg.svd(H @ left, full_matrices=True)
    largest = float(np.linalg.norm(H, 2))
    return np.asarray(left @ Vt[int(np.sum(s > min_share * largest)) :].T)
