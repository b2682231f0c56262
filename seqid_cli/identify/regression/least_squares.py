"""Least squares that never stacks a regressor.

The rows of one joint's equation, [H y] of a block of samples, are reduced to the
triangular factor of their QR decomposition. Factors of blocks merge by another QR, in
any order and in constant memory:

    [H y] = Q [R z; 0 e],    min ||H theta - y||^2  =  min ||R theta - z||^2 + e^2.

Each joint has its own factor, so joints are weighted by their noise without another
pass, and the columns of links that it does not carry, being zero, cost nothing. What
comes out depends on the rows of a log and on how they are cut into blocks, not on where
the log was reduced: signs are fixed and blocks merge in their order. The factors of
blocks (about a second of motion each) are kept as well, merged pairwise when they
become many: the moves of the estimate without one block give standard errors that hold
for autocorrelated residuals; the white-noise formula's are too small.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.typing import Array, Mask

# Blocks that are kept; from then on neighbours merge. Their memory, and the time of the
# jackknife, stay small, and a log of minutes has blocks of a second all the same.
MOST_BLOCKS = 256
# A direction counts as excited from this share of the largest singular value of scaled
# columns.
RANK_TOLERANCE = 1e-3
# A parameter is determined where its share of directions that are not excited is below.
OPEN_SHARE = 1e-4
# Columns below this share of the largest hold rounding alone.
ROUNDING = 1e-9
# A direction in which the blocks happen to agree is not known better than this share of
# what white noise allows.
WHITE_FLOOR = 0.05
# A move of the estimate without a block is believed up to so many times its first
# order: beyond, the rest without that block is all but singular.
REGULAR_RATIO = 4.0
LEAST_SIGMA = 1e-12  # N m


def triangular(rows: Array) -> Array:
    """Return the triangular factor (p, p) of rows (N, p), its diagonal not negative.

    Columns of zeros cost nothing.
    """
    filled = np.flatnonzero(rows.any(axis=0))
    R = np.asarray(np.linalg.qr(rows[:, filled], mode="r"), dtype=np.float64)
    signs = np.where(R.diagonal() < 0, -1.0, 1.0)
    factor = np.zeros((rows.shape[1], rows.shape[1]))
    factor[filled[: len(R), None], filled] = signs[:, None] * R
    return factor


@dataclass
class Accumulator:
    """Factors of one joint's equations with p parameters.

    `blocks` (p + 1, p + 1) are the factors of [H y] of blocks of time, `rows` how many
    each has, `span` how many additions go into a block, and `filled` how many of them
    the last one has.
    """

    size: int
    blocks: list[Array] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)
    span: int = 1
    filled: int = 1
    _total: Array | None = field(default=None, repr=False, compare=False)

    def add(self, H: Array, y: Array, where: Mask | None = None) -> None:
        """Add one block of rows.

        Parameters
        ----------
        H : (N, p) array
            Regressor; cheapest with a column's samples in a row.
        y : (N,) array
            Right side [N m].
        where : (N,) array of bool, optional
            Rows that count. A block without any keeps the joints' blocks in step.
        """
        self._total = None
        if where is None:
            columns = np.vstack([H.T, y])
        else:
            columns = np.vstack([H.T[:, where], y[where]])
        n_rows = columns.shape[1]
        factor = triangular(columns.T)

        if self.blocks and self.filled < self.span:
            if n_rows:
                self.blocks[-1] = triangular(np.vstack([self.blocks[-1], factor]))
            self.rows[-1] += n_rows
            self.filled += 1
        else:
            self.blocks.append(factor)
            self.rows.append(n_rows)
            self.filled = 1
        while len(self.blocks) > MOST_BLOCKS:
            self._halve()

    def __add__(self, other: "Accumulator") -> "Accumulator":
        first = copy(self)
        second = copy(other)
        for accumulator in (first, second):  # blocks of one length
            while accumulator.span < max(self.span, other.span):
                accumulator._halve()
        merged = Accumulator(
            size=self.size,
            blocks=first.blocks + second.blocks,
            rows=first.rows + second.rows,
            span=first.span,
            filled=first.span,
        )
        while len(merged.blocks) > MOST_BLOCKS:
            merged._halve()
        return merged

    def repeated(self, other: "Accumulator", first: int) -> "Accumulator":
        """Return the rows of both, those of `other` in the blocks from `first` on.

        Both have blocks of one length.
        """
        joined = copy(self)
        joined.blocks = list(self.blocks)
        joined.rows = list(self.rows)
        joined._total = None
        for k, (factor, n_rows) in enumerate(
            zip(other.blocks, other.rows, strict=True)
        ):
            both = np.vstack([self.blocks[first + k], factor])
            joined.blocks[first + k] = triangular(both)
            joined.rows[first + k] += n_rows
        return joined

    def _halve(self) -> None:
        """Merge each two neighbouring blocks; one without a partner stays."""
        if len(self.blocks) % 2 == 0:
            self.filled += self.span
        blocks: list[Array] = []
        rows: list[int] = []
        for first in range(0, len(self.blocks), 2):
            pair = self.blocks[first : first + 2]
            blocks.append(triangular(np.vstack(pair)) if len(pair) == 2 else pair[0])
            rows.append(sum(self.rows[first : first + 2]))
        self.blocks = blocks
        self.rows = rows
        self.span *= 2

    @property
    def total(self) -> Array:
        """Factor (p + 1, p + 1) of all rows, from the blocks in their order."""
        if self._total is None:
            blocks = self.blocks or [np.zeros((0, self.size + 1))]
            self._total = triangular(np.vstack(blocks))
        return self._total

    def joined(self) -> "Accumulator":
        """Return the same rows with one factor for all blocks."""
        return Accumulator(
            size=self.size,
            blocks=[self.total],
            rows=[self.samples],
            span=self.span,
            filled=self.filled,
            _total=self.total,
        )

    @property
    def samples(self) -> int:
        """Number of rows added."""
        return sum(self.rows)

    def with_fixed(self, column: int, value: float) -> "Accumulator":
        """Return the same rows with one parameter held at a value and taken out."""
        factors = np.stack([self.total, *self.blocks])
        fewer = np.delete(factors, column, axis=2)
        fewer[:, :, -1] -= value * factors[:, :, column]
        # The rows above the column are as they should be.
        below = np.asarray(
            np.linalg.qr(fewer[:, column:, column:], mode="r"), dtype=np.float64
        )
        negative = np.diagonal(below, axis1=1, axis2=2) < 0
        fewer[:, column:-1, column:] = below * np.where(negative, -1.0, 1.0)[:, :, None]
        total, *blocks = fewer[:, :-1].copy()
        return Accumulator(
            size=self.size - 1,
            blocks=blocks,
            rows=list(self.rows),
            span=self.span,
            filled=self.filled,
            _total=total,
        )

    def residual_rms(self, theta: Array, fitted: int = 0) -> float:
        """Return the RMS of H theta - y, with `fitted` degrees of freedom taken off."""
        norm = np.linalg.norm(self.total @ np.append(theta, -1.0))
        return float(norm / np.sqrt(max(self.samples - fitted, 1)))


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Knowledge of earlier stages: rows A theta = b of unit variance, (k, p) and (k,).

    `friction` (k, K_j) by joint, `constants` (k,) by joint and `tolerances` (k,) by
    name are the moves of b: by the coefficients of friction, by the errors of torque
    constants, and by tolerances that no log shows.
    """

    A: Array
    b: Array
    friction: dict[int, Array] = field(default_factory=dict)
    constants: dict[int, Array] = field(default_factory=dict)
    tolerances: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Weighted least squares over all joints.

    Attributes
    ----------
    theta : (p,) array
        The estimate.
    covariance : (p, p) array
        By the block jackknife, the prior's own errors included.
    determined : (p,) array of bool
        False for parameters that these data do not distinguish from others; their
        values are one choice among many (the smallest) and must not be reported.
    rank, condition : int, float
        Of the parameters alone, nuisances being marginalised.
    sigma : (n,) array
        Residual RMS of each joint [N m].
    bread : (p, p) array
        Inverse of the weighted normal matrix.
    left_open : (p, p - rank) array
        Directions along which nothing is known.
    moves : (G, p) array
        By which the estimate moves without one block of time.
    shares : (n, p) array
        What of the estimate comes from each joint's right side.
    designs : (n,) array
        Variance that each joint's residual makes, over that of white noise.
    """

    theta: Array
    covariance: Array
    determined: Mask
    rank: int
    condition: float
    sigma: Array
    bread: Array
    left_open: Array
    moves: Array
    shares: Array
    designs: Array

    def first(self, count: int) -> "Solution":
        """Return the same without all but the first so many parameters."""
        return replace(
            self,
            theta=self.theta[:count],
            covariance=self.covariance[:count, :count],
            determined=self.determined[:count],
            bread=self.bread[:count, :count],
            left_open=self.left_open[:count],
            moves=self.moves[:, :count],
            shares=self.shares[:, :count],
        )


def solve(
    joints: Sequence[Accumulator],
    *,
    prior: Prior | None = None,
    iterations: int = 3,
    independent: float = 1.0,
    nuisances: slice = slice(0, 0),
) -> Solution:
    """Solve for all joints together, weighted by residuals, with a block jackknife.

    Parameters
    ----------
    joints : sequence of Accumulator
        Rows of each joint, with the same p parameters.
    prior : Prior, optional
        What is known before.
    iterations : int
        Rounds of reweighting.
    independent : float
        Share of the samples that counts beside the prior: low-passed noise does not
        count more where there are more samples of it.
    nuisances : slice
        Columns that the prior determines where the rows do not; rank and condition are
        of the others, these being marginalised.
    """
    size = joints[0].size
    totals = [joint.total for joint in joints]
    n_nuisances = len(range(*nuisances.indices(size)))
    # A joint with hardly any rows has no residual to be weighted by.
    fewest = (size - n_nuisances) // 4
    used = [k for k, joint in enumerate(joints) if joint.samples > fewest]

    # Each joint by itself first, not by R's last entry: rounding decides it where
    # columns depend.
    sigma = np.zeros(len(joints))
    for k, joint in enumerate(joints):
        alone = _solve_scaled(totals[k])
        sigma[k] = joint.residual_rms(alone.theta, fitted=alone.root.shape[1])
    sigma = np.maximum(sigma, LEAST_SIGMA)

    prior_rows = []
    if prior is not None:
        prior_rows.append(np.column_stack([prior.A, prior.b]))
    filled = np.zeros(size, dtype=bool)
    for rows in [*(totals[k] for k in used), *prior_rows]:
        filled |= _filled_columns(rows[:, :-1])

    for _ in range(iterations):
        # of the factor: what follows must use the same
        scale = sigma / np.sqrt(independent)
        stack = [*(totals[k] / scale[k] for k in used), *prior_rows]
        factor = np.zeros((size + 1, size + 1))
        if stack:
            factor = triangular(np.vstack(stack))
        solved = _solve_marginalised(factor, filled, nuisances)
        residual_rms = [joint.residual_rms(solved.theta) for joint in joints]
        sigma = np.maximum(residual_rms, LEAST_SIGMA)

    bread = solved.root @ solved.root.T
    blocks = {k: joints[k].blocks for k in used}
    moves, designs = _jackknife(blocks, scale, solved.theta, factor, bread)
    covariance = spread_of(moves) + WHITE_FLOOR * bread
    if prior is not None:  # of unit variance: no residual to learn it from
        by_prior = prior.A @ bread
        covariance += by_prior.T @ by_prior
    shares = np.zeros((len(joints), size))
    for k in used:
        R = totals[k][:, :-1]
        z = totals[k][:, -1]
        shares[k] = bread @ (R.T @ z) / scale[k] ** 2
    return Solution(
        theta=solved.theta,
        covariance=covariance,
        determined=solved.determined,
        rank=solved.root.shape[1] - n_nuisances,
        condition=solved.condition,
        sigma=sigma,
        bread=bread,
        left_open=solved.left_open,
        moves=moves,
        shares=shares,
        designs=designs,
    )


def _filled_columns(rows: Array) -> Mask:
    """Return the columns (p,) of one noise's rows (k, p) that exceed rounding."""
    norms = np.linalg.norm(rows, axis=0)
    return np.asarray(norms > ROUNDING * norms.max(initial=1e-300))


@dataclass(frozen=True, kw_only=True)
class ScaledSolution:
    """The smallest solution with scaled columns.

    With `root` (p, r), (H'H)^+ = root root' over the r directions that are excited.
    `left_open` (p, p - r) are the directions that are not, `determined` (p,) which
    parameters have no part in those.
    """

    theta: Array
    root: Array
    left_open: Array
    condition: float
    determined: Mask


def _solve_scaled(factor: Array, filled: Mask | None = None) -> ScaledSolution:
    """Solve a factor [R z] of (p + 1) columns, of those that are `filled` (p,)."""
    R = factor[:-1, :-1]
    z = factor[:-1, -1]
    scale = np.linalg.norm(R, axis=0)
    if filled is None:
        filled = _filled_columns(R)
    scale[~filled] = np.inf

    U, s, Vt = np.linalg.svd(R / scale)
    excited = np.zeros(len(s), dtype=bool)
    if s[0] > 0:
        excited = s > RANK_TOLERANCE * s[0]
    root = (Vt[excited].T / s[excited]) / scale[:, None]
    condition = float(s[excited][0] / s[excited][-1]) if excited.any() else 0.0
    is_finite = np.isfinite(scale)
    left_open = Vt[~excited].T / np.where(is_finite, scale, 1.0)[:, None]
    excited_share = np.sum(Vt[excited] ** 2, axis=0)
    return ScaledSolution(
        theta=root @ (U[:, excited].T @ z),
        root=root,
        left_open=left_open,
        condition=condition,
        determined=is_finite & (excited_share > 1 - OPEN_SHARE),
    )


def _solve_marginalised(
    factor: Array, filled: Mask, nuisances: slice
) -> ScaledSolution:
    """Solve as `_solve_scaled` does, but require excitation of no nuisance term.

    A nuisance term that resembles a parameter is told apart by its prior, however weak
    that is beside the rows: it is no direction to be dropped.
    """
    columns = np.arange(len(factor) - 1)
    first = columns[nuisances]
    count = len(first)
    if not count:
        return _solve_scaled(factor, filled)

    # With the nuisances first, the rows below theirs are of what they leave of the
    # others.
    others = np.setdiff1d(columns, first)
    ordered = factor[:, [*first, *others, len(columns)]]
    R = np.asarray(np.linalg.qr(ordered, mode="r"), dtype=np.float64)
    rest = _solve_scaled(R[count:, count:], filled[others])
    inner = R[:count, :count]
    across = R[:count, count:-1]

    size = len(columns)
    rank = rest.root.shape[1]
    theta = np.zeros(size)
    theta[others] = rest.theta
    theta[first] = np.linalg.solve(inner, R[:count, -1] - across @ rest.theta)
    root = np.zeros((size, count + rank))
    root[np.ix_(others, np.arange(count, count + rank))] = rest.root
    root[first, :count] = np.linalg.inv(inner)
    root[first, count:] = -np.linalg.solve(inner, across @ rest.root)
    left_open = np.zeros((size, rest.left_open.shape[1]))
    left_open[others] = rest.left_open
    determined = np.ones(size, dtype=np.bool_)
    determined[others] = rest.determined
    return ScaledSolution(
        theta=theta,
        root=root,
        left_open=left_open,
        condition=rest.condition,
        determined=determined,
    )


def _jackknife(
    blocks: dict[int, list[Array]],
    sigma: Array,
    theta: Array,
    factor: Array,
    bread: Array,
) -> tuple[Array, Array]:
    """Return moves (G, p) of the estimate without one time block, and designs (n,).

    With G blocks of normal matrix A_b and score s_b the estimate without block b moves
    by (A - A_b)^-1 s_b; the covariance is the sum of squares of these moves. Unlike the
    sandwich it does not shrink when a block has leverage. The scores of one joint
    alone, over what white noise would make of them, are its design effect.

    Parameters
    ----------
    blocks : dict of lists of (p + 1, p + 1) arrays
        Factors of each joint's blocks.
    sigma : (n,) array
        Standard deviations by which joints are weighted.
    theta : (p,) array
    factor : (p + 1, p + 1) array
        Of all rows together, weighted.
    bread : (p, p) array
        Inverse of its normal matrix.
    """
    n_blocks = max(map(len, blocks.values()), default=0)
    block_normals = np.zeros((n_blocks, *bread.shape))
    joint_scores = np.zeros((len(sigma), n_blocks, len(theta)))
    designs = np.ones(len(sigma))
    for k, factors in blocks.items():
        R = np.stack(factors) / sigma[k]
        Ht = R[:, :, :-1].transpose(0, 2, 1)
        residual = R @ np.append(-theta, 1.0)
        scores_of_joint = (Ht @ residual[:, :, None])[:, :, 0]
        normals = Ht @ R[:, :, :-1]
        block_normals[: len(R)] += normals
        joint_scores[k, : len(R)] = scores_of_joint
        white = np.trace(bread @ normals.sum(axis=0))
        # Over all blocks: those that this joint has no rows in score nothing.
        spread = np.sum((joint_scores[k] @ bread) * joint_scores[k])
        designs[k] = spread / max(white, 1e-300)

    # (A - A_b)^+ s_b within the excited directions; the plain score where that is not
    # regular.
    scores = joint_scores.sum(axis=0)
    plain = scores @ bread
    without_block = np.eye(len(bread)) - bread @ block_normals
    try:
        moves = np.linalg.solve(without_block, plain[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        moves = (np.linalg.pinv(without_block) @ plain[:, :, None])[:, :, 0]
    normal = factor[:-1, :-1].T @ factor[:-1, :-1]
    plain_size = np.sqrt(_squares(plain, normal))
    regular: Mask = np.sqrt(_squares(moves, normal)) <= REGULAR_RATIO * plain_size
    moves = np.where(regular[:, None], moves, plain)

    # Few blocks: what the fit itself has taken of their residuals.
    expected = max(np.sum(plain * scores), 1e-300)
    leverage = np.sum((moves @ normal) * moves) / expected
    return moves, designs * leverage


def _squares(moves: Array, normal: Array) -> Array:
    """Return squared sizes (G,) of moves (G, p) in units of a normal matrix (p, p)."""
    squares = np.einsum("bi,ij,bj->b", moves, normal, moves)
    return np.asarray(squares.clip(0.0))


def spread_of(moves: Array) -> Array:
    """Return the covariance (p, p) by the jackknife's moves (G, p)."""
    count = len(moves)
    return np.asarray(moves.T @ moves * (max(count - 1, 1) / max(count, 1)))


def whitened(covariance: Array) -> Array:
    """Return rows L with L' L the (pseudo-)inverse of a covariance, as a prior."""
    value, vector = np.linalg.eigh((covariance + covariance.T) / 2)
    known_directions = value > 1e-14 * max(value.max(initial=0.0), 1e-300)
    scaled = vector[:, known_directions] / np.sqrt(value[known_directions])
    return np.asarray(scaled.T)
