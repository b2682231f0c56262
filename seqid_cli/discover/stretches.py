"""Slow candidates: whether their coefficients hold from one stretch of time to the next.

Torque noise has slow parts, and each log comes with its own. An offset or a ramp fits a few such
values well however many samples they were made of, so that its error is what leaving out one
stretch after the other changes (cluster jackknife, F distribution; Cameron and Miller, "A
practitioner's guide to cluster-robust inference", 2015).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from seqid_cli.discover.rows import BLOCK_S, Rows
from seqid_cli.discover.system import System

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STRETCH_S = 10.0  # well beyond the slowest noise of a drive
ENOUGH = 12  # stretches, for which they may be shorter where the effect is not slow itself


def chance(system: System, columns: Mapping[int, Array], *, slow: bool = True) -> float:
    """Probability that coefficients as far from zero come from noise alone, coloured as it is.

    Parameters
    ----------
    system : System
        Base and accepted effects, without the candidate.
    columns : joint -> (M_j, k)
        The candidate's rows.
    slow : bool
        Whether the candidate changes over minutes only: its stretches are never short.

    Returns
    -------
    float
        1 where there are no more stretches than coefficients.
    """
    rows = system.rows
    length = STRETCH_S if slow else min(STRETCH_S, BLOCK_S * len(rows.fold) / ENOUGH)
    of_block = _stretch_of_block(rows, length)
    count = int(of_block.max()) + 1
    width = _width(columns)
    squares, scores = np.zeros((count, width, width)), np.zeros((count, width))
    for joint, (X, r) in system.beside(columns).items():
        own = of_block[rows.blocks_of(joint)]
        np.add.at(squares, own, X[:, :, None] * X[:, None, :])
        np.add.at(scores, own, X * r[:, None])
    present = np.flatnonzero(np.any(squares, axis=(1, 2)))
    free = len(present) - width
    if free < 1:
        return 1.0
    whole, given = squares.sum(axis=0), scores.sum(axis=0)
    a = np.linalg.pinv(whole) @ given
    without = np.array([np.linalg.pinv(whole - squares[g]) @ (given - scores[g]) for g in present])
    shift = without - a
    covariance = shift.T @ shift * (len(present) - 1) / len(present)
    wald = float(a @ np.linalg.pinv(covariance) @ a) / width
    return float(f_distribution.sf(wald, width, free))


def slowness(system: System, columns: Mapping[int, Array]) -> float:
    """Share of what a candidate explains that is constant in each stretch of time.

    Motions decide it: an asymmetry of Coulomb friction is an offset wherever the joint slides.

    Parameters
    ----------
    system : System
        Base and accepted effects, without the candidate.
    columns : joint -> (M_j, k)
        The candidate's rows.
    """
    rows, beside = system.rows, system.beside(columns)
    of_block = _stretch_of_block(rows, STRETCH_S)
    whole = sum((X.T @ X for X, _ in beside.values()), np.zeros(2 * (_width(columns),)))
    given = sum((X.T @ r for X, r in beside.values()), np.zeros(_width(columns)))
    a = np.linalg.pinv(whole) @ given
    lasting = 0.0
    for joint, (X, _) in beside.items():
        own, torque = of_block[rows.blocks_of(joint)], X @ a
        lasting += float(np.sum(np.bincount(own, torque) ** 2 / np.maximum(np.bincount(own), 1)))
    return lasting / max(float(a @ whole @ a), 1e-300)


def _width(columns: Mapping[int, Array]) -> int:
    return int(next(iter(columns.values())).shape[1])


def _stretch_of_block(rows: Rows, length: float) -> Index:
    """Number of the stretch that each block belongs to; stretches end with their log."""
    whole = max(1, round(length / BLOCK_S))
    stretch, first = np.zeros(len(rows.fold), dtype=np.intp), 0
    for block in rows.block:
        start, blocks = int(block.min()), int(block.max() - block.min()) + 1
        count = max(1, blocks // whole)
        stretch[start : start + blocks] = first + np.arange(blocks) * count // blocks
        first += count
    return stretch
