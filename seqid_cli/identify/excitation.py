"""Which pairs of joints must move together to determine what is still open (Sec. 2.2.4)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.least_squares import RANK_TOLERANCE, Accumulator
from seqid_cli.robot.base import Basis, base_regressor
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

STATES = 120


def missing_pairs(robot: Robot, basis: Basis, joints: Sequence[Accumulator]) -> list[list[str]]:
    """Choose pairs greedily until every base parameter is seen.

    Parameters
    ----------
    robot : Robot
    basis : Basis
    joints : sequence of Accumulator
        What the logs hold already.

    Returns
    -------
    list of pairs of joint names
        Empty where no pair of joints would add anything.
    """
    data = np.vstack([joint.total[:-1, :-1] for joint in joints])
    open_directions = _null_space(data)
    candidates = list(combinations(range(robot.n), 2)) or [(0, 0)]
    seen = {pair: _pair_regressor(robot, basis, pair) for pair in candidates}
    chosen: list[list[str]] = []
    while open_directions.shape[1]:
        ranks = {p: _rank(H @ open_directions) for p, H in seen.items()}
        best = max(ranks, key=lambda pair: ranks[pair])
        if ranks[best] == 0:
            break
        chosen.append([robot.joint_names[j] for j in best])
        left = _null_space(seen[best] @ open_directions)
        open_directions = open_directions @ left
    return chosen


def _pair_regressor(robot: Robot, basis: Basis, pair: tuple[int, int]) -> Array:
    """Rows of the two moving joints in random states with all others locked at random angles."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.5, 2.5, (STATES, robot.n))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    moving = list(pair)
    dq[:, moving] = rng.normal(size=(STATES, 2))
    ddq[:, moving] = 3 * rng.normal(size=(STATES, 2))
    H = base_regressor(robot, basis, q, dq, ddq)[:, moving]
    return H.reshape(-1, basis.size)


def _null_space(rows: Array) -> Array:
    scale = np.linalg.norm(rows, axis=0)
    scale[scale < 1e-9 * max(scale.max(initial=0.0), 1e-300)] = 1.0
    _, s, Vt = np.linalg.svd(rows / scale, full_matrices=True)
    count = int(np.sum(s > RANK_TOLERANCE * max(s[0], 1e-300))) if len(s) else 0
    space: Array = Vt[count:].T / scale[:, None]
    return space


def _rank(rows: Array) -> int:
    s = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(s > 1e-6 * max(float(s.max(initial=0.0)), 1e-9)))
