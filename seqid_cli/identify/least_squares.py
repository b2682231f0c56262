"""Least squares that never stacks a regressor.

The rows of one joint's equation, [H y] of a block of samples, are reduced to the triangular factor
of their QR decomposition. Factors of blocks merge by another QR, in any order and in constant
memory:

    [H y] = Q [R z; 0 e],    min ||H theta - y||^2  =  min ||R theta - z||^2 + e^2.

Each joint has its own factor, so joints are weighted by their noise without another pass, and the
columns of links that it does not carry, being zero, cost nothing. What comes out depends on the
rows and on how they are cut into blocks, not on where the blocks were reduced: signs are fixed and
blocks merge pairwise in their order. The factors of blocks (about a second of motion each) are kept
as well, merged pairwise when they become many: what one block says against all others gives
standard errors that hold for autocorrelated residuals, where the white-noise formula is far too
small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dtpqrt

Array = NDArray[np.float64]

MOST_BLOCKS = 400
WHITE_FLOOR = 0.05
PANEL = 8  # columns that the blocked QR takes at once
STRIP = 512  # rows that it takes at once: they stay in cache
NARROW = 16  # columns below which there is nothing to block
RANK_TOLERANCE = 1e-3  # singular value of scaled columns, over the largest, that counts as excited


def triangular(rows: Array) -> Array:
    """Triangular factor (p, p) of rows (N, p), diagonal not negative.

    Columns of zeros give columns and rows of zeros.
    """
    p = rows.shape[1]
    factor = np.zeros((p, p))
    alive = np.flatnonzero(rows.any(axis=0))
    if not len(alive):
        return factor
    R = _reduced(rows if len(alive) == p else rows[:, alive])
    factor[np.ix_(alive[: len(R)], alive)] = R
    factor[np.diag(factor) < 0] *= -1
    return factor


def _factor_of(H: Array, y: Array) -> Array:
    """As `triangular` of [H y], without putting zeros beside each other."""
    factor = np.zeros((H.shape[1] + 1, H.shape[1] + 1))
    alive = np.append(np.flatnonzero(H.any(axis=0)), H.shape[1])
    if not len(y):
        return factor
    columns = np.empty((len(alive), len(y)))
    columns[:-1], columns[-1] = H.T[alive[:-1]], y
    R = _reduced(columns.T)
    factor[np.ix_(alive[: len(R)], alive)] = R
    factor[np.diag(factor) < 0] *= -1
    return factor


def _reduced(rows: Array) -> Array:
    """R of the QR decomposition of rows (N, k), (min(N, k), k)."""
    count, k = rows.shape
    if k < NARROW or count <= 2 * k:
        found, *_ = dgeqrf(rows, lwork=32 * k)
        return np.triu(found[:k])
    R = np.zeros((k, k), order="F")
    for start in range(0, count, STRIP):
        strip = np.array(rows[start : start + STRIP], order="F")
        R, *_ = dtpqrt(0, PANEL, R, strip, overwrite_a=True, overwrite_b=True)
    return np.triu(R)


@dataclass
class Accumulator:
    """Factors of one joint's equations with p parameters: `blocks` (p + 1, p + 1) of [H y]."""

    size: int
    blocks: list[Array] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)

    def add(self, H: Array, y: Array) -> None:
        """Add one block of rows H (N, p), y (N,); an empty one keeps the joints' blocks in step."""
        self.blocks.append(_factor_of(H, y))
        self.rows.append(len(y))
        self._bound()

    def __add__(self, other: Accumulator) -> Accumulator:
        """The rows of both, those of `other` behind."""
        both = Accumulator(self.size, self.blocks + other.blocks, self.rows + other.rows)
        both._bound()
        return both

    def _bound(self) -> None:
        """Merge neighbouring blocks where there are too many."""
        while len(self.blocks) > MOST_BLOCKS:
            pairs = range(0, len(self.blocks), 2)
            self.blocks = [triangular(np.vstack(self.blocks[i : i + 2])) for i in pairs]
            self.rows = [sum(self.rows[i : i + 2]) for i in pairs]

    @property
    def total(self) -> Array:
        """Factor of all rows, merged in a fixed order."""
        level = self.blocks or [np.zeros((self.size + 1, self.size + 1))]
        while len(level) > 1:
            level = [triangular(np.vstack(level[i : i + 2])) for i in range(0, len(level), 2)]
        return level[0]

    @property
    def samples(self) -> int:
        """Number of rows added."""
        return sum(self.rows)

    def with_fixed(self, column: int, value: float) -> Accumulator:
        """The same rows with one parameter held at a value and taken out."""
        kept = [c for c in range(self.size + 1) if c != column]
        blocks = []
        for R in self.blocks:
            if R[:, column].any():
                right = R[:, -1] - value * R[:, column]
                blocks.append(triangular(np.column_stack([R[:, kept[:-1]], right])))
            else:
                blocks.append(R[np.ix_(kept, kept)])
        return Accumulator(self.size - 1, blocks, list(self.rows))

    def residual_rms(self, theta: Array) -> float:
        """RMS of H theta - y over all rows."""
        return _residual_rms(self.total, self.samples, theta)


@dataclass(frozen=True)
class Prior:
    """What earlier stages know: rows A theta = b with unit variance, (k, p) and (k,)."""

    A: Array
    b: Array

    @property
    def factor(self) -> Array:
        """As a block [A b]."""
        return np.column_stack([self.A, self.b])


@dataclass(frozen=True)
class Solution:
    """Weighted least squares over all joints.

    `determined` (p,) is False for parameters that these data cannot tell from others; their values
    are one choice among many (the smallest) and must not be reported. `left_open` (p, p - rank) are
    the directions along which nothing is known.
    """

    theta: Array
    covariance: Array
    determined: NDArray[np.bool_]
    rank: int
    condition: float
    sigma: Array  # residual RMS per joint
    bread: Array  # inverse of the weighted normal matrix
    left_open: Array


def solve(
    joints: Sequence[Accumulator], *, prior: Prior | None = None, iterations: int = 3
) -> Solution:
    """Solve for all joints together, each weighted by its own residual.

    Parameters
    ----------
    joints : sequence of Accumulator
        One per joint, all of the same parameters.
    prior : Prior, optional
        Knowledge from earlier stages.
    iterations : int
        Rounds of reweighting by residual RMS.

    Returns
    -------
    Solution
        Estimate with block-jackknife covariance.
    """
    size = joints[0].size
    totals = [joint.total for joint in joints]
    used = [k for k, joint in enumerate(joints) if joint.samples > size // 4]
    floors = [_floor(joint, R) for joint, R in zip(joints, totals, strict=True)]
    sigma = np.maximum(floors, 1e-12)
    theta = np.zeros(size)
    for _ in range(iterations):
        stack = [totals[k] / sigma[k] for k in used]
        if prior is not None:
            stack.append(prior.factor)
        factor = triangular(np.vstack(stack)) if stack else np.zeros((size + 1, size + 1))
        theta, basis, left_open, condition = _solve_scaled(factor)
        left = [
            _residual_rms(R, joint.samples, theta) for joint, R in zip(joints, totals, strict=True)
        ]
        sigma = np.maximum(left, 1e-12)
    rank = basis.shape[1]
    bread = basis @ basis.T
    covariance = _jackknife(joints, used, sigma, theta, factor, bread)
    covariance += _prior_part(factor, [totals[k] / sigma[k] for k in used], bread)
    # A direction in which the blocks happen to agree is not known better than white noise allows.
    covariance += WHITE_FLOOR * bread
    determined = _determined(factor, basis)
    return Solution(theta, covariance, determined, rank, condition, sigma, bread, left_open)


def _residual_rms(R: Array, samples: int, theta: Array) -> float:
    """RMS of the residual of rows with the factor R of [H y]."""
    return float(np.linalg.norm(R @ np.append(theta, -1.0)) / np.sqrt(max(samples, 1)))


def _floor(joint: Accumulator, R: Array) -> float:
    """Residual RMS of this joint fitted by itself: the first weight."""
    # Not from R's last entry: where columns depend on each other, rounding decides what is left.
    theta, basis, *_ = _solve_scaled(R)
    left = np.linalg.norm(R @ np.append(theta, -1.0))
    return float(left / np.sqrt(max(joint.samples - basis.shape[1], 1)))


def _solve_scaled(factor: Array) -> tuple[Array, Array, Array, float]:
    """Smallest solution with scaled columns.

    Also returns B with (H'H)^+ = B B' over what is excited, the directions that are not, and the
    condition.
    """
    R, z = factor[:-1, :-1], factor[:-1, -1]
    scale = np.linalg.norm(R, axis=0)
    scale[scale < 1e-9 * scale.max(initial=1e-300)] = np.inf
    U, s, Vt = np.linalg.svd(R / scale)
    kept = s > RANK_TOLERANCE * s[0] if s[0] > 0 else np.zeros(len(s), dtype=bool)
    basis = (Vt[kept].T / s[kept]) / scale[:, None]
    theta = basis @ (U[:, kept].T @ z)
    condition = float(s[kept][0] / s[kept][-1]) if kept.any() else 0.0
    left_open = Vt[~kept].T / np.where(np.isfinite(scale), scale, 1.0)[:, None]
    return theta, basis, left_open, condition


def _determined(factor: Array, basis: Array) -> NDArray[np.bool_]:
    """Parameters without a part in the directions that are not excited."""
    R = factor[:-1, :-1]
    scale = np.linalg.norm(R, axis=0)
    alive = scale > 1e-9 * scale.max(initial=1e-300)
    if basis.shape[1] == 0:
        return np.zeros(len(scale), dtype=bool)
    scaled = basis * np.where(alive, scale, 0.0)[:, None]
    Q, _ = np.linalg.qr(scaled)
    inside = np.sum(Q**2, axis=1)
    determined: NDArray[np.bool_] = alive & (inside > 1 - 1e-4)
    return determined


def _jackknife(
    joints: Sequence[Accumulator],
    used: list[int],
    sigma: Array,
    theta: Array,
    factor: Array,
    bread: Array,
) -> Array:
    """Covariance from leaving out one block of time at a time.

    With G blocks of normal matrix A_b and score s_b the estimate without block b moves by
    (A - A_b)^-1 s_b; the covariance is the sum of squares of these moves. Unlike the sandwich it
    does not shrink when a block has leverage.
    """
    normal = factor[:-1, :-1].T @ factor[:-1, :-1]
    count = max((len(joints[k].blocks) for k in used), default=0)
    covariance = np.zeros_like(bread)
    extended = np.append(-theta, 1.0)
    for b in range(count):
        A_b, s_b = np.zeros_like(bread), np.zeros(len(theta))
        for k in used:
            if b < len(joints[k].blocks):
                R = joints[k].blocks[b] / sigma[k]
                A_b += R[:, :-1].T @ R[:, :-1]
                s_b += R[:, :-1].T @ (R @ extended)
        move = _downdated(normal, A_b, bread, s_b)
        covariance += np.outer(move, move)
    share = max(count - 1, 1) / max(count, 1)
    return covariance * share


def _downdated(normal: Array, A_b: Array, bread: Array, s_b: Array) -> Array:
    """(A - A_b)^+ s_b within the excited directions; the plain score where that is not regular."""
    reduced = np.eye(len(bread)) - bread @ A_b
    plain = bread @ s_b
    try:
        move: Array = np.asarray(np.linalg.solve(reduced, plain), dtype=np.float64)
    except np.linalg.LinAlgError:
        return plain
    longest = 4.0 * np.sqrt(max(float(plain @ normal @ plain), 0.0))
    return move if np.sqrt(max(float(move @ normal @ move), 0.0)) <= longest else plain


def _prior_part(factor: Array, totals: Sequence[Array], bread: Array) -> Array:
    """The prior's own part: its rows have unit variance and leave no residual to learn it from."""
    R = factor[:-1, :-1]
    prior = R.T @ R
    for total in totals:
        R = total[:-1, :-1]
        prior -= R.T @ R
    part: Array = bread @ prior @ bread
    return (part + part.T) / 2


def whitened(covariance: Array) -> Array:
    """Rows L with L' L the (pseudo-)inverse of a covariance: a stage's result as a prior."""
    value, vector = np.linalg.eigh((covariance + covariance.T) / 2)
    kept = value > 1e-14 * max(value.max(initial=0.0), 1e-300)
    rows: Array = (vector[:, kept] / np.sqrt(value[kept])).T
    return rows
