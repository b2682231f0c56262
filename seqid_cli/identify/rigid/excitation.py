"""Which pairs of joints must move together to determine what is still open (Sec. 2.2.4)."""

from itertools import combinations

import numpy as np

from seqid_cli.robot.base_parameters import Basis, base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def missing_pairs(
    robot: Robot, basis: Basis, left_open: Array, *, states: int = 120
) -> list[list[str]]:
    """Choose pairs greedily until every base parameter is seen, and none that the others make idle.

    `left_open` (b, k): directions of the base parameters that are not determined yet. `states`:
    random ones of two moving joints, the others at random angles. Returns: empty where no pair
    would add anything; each pair once. An arm of one joint has that alone.
    """
    seen: dict[tuple[int, int], Array] = {}
    for pair in list(combinations(range(robot.n), 2)) or [(0, 0)]:
        rng = np.random.default_rng(0)
        q = rng.uniform(-2.5, 2.5, (states, robot.n))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        dq[:, list(pair)] = rng.normal(size=(states, 2))
        ddq[:, list(pair)] = 3 * rng.normal(size=(states, 2))
        H = base_regressor(robot, basis, q, dq, ddq)[:, list(pair)]
        seen[pair] = H.reshape(-1, basis.size)
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
    for pair in list(chosen):
        others = [seen[each] for each in chosen if each != pair]
        if others and _still_open(np.vstack(others), first).shape[1] <= left.shape[1]:
            chosen.remove(pair)
    return [[robot.joint_names[j] for j in dict.fromkeys(pair)] for pair in chosen]


def _still_open(H: Array, left: Array, *, min_share: float = 1e-6) -> Array:
    """The part of the directions `left` (b, k), orthonormal, that rows H (N, b) do not see."""
    # Singular values below `min_share` of the largest are rounding.
    _, s, Vt = np.linalg.svd(H @ left, full_matrices=True)
    largest = float(np.linalg.norm(H, 2))
    return np.asarray(left @ Vt[int(np.sum(s > min_share * largest)) :].T)
