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


def triangular(rows: Array) -> Array:
    """Triangular factor (p, p) of rows (N, p), diagonal not negative; zero columns cost nothing."""
    alive = np.flatnonzero(rows.any(axis=0))
    R = np.asarray(np.linalg.qr(rows[:, alive], mode="r"), dtype=np.float64)
    full = np.zeros((rows.shape[1], rows.shape[1]))
    full[alive[: len(R), None], alive] = (
        np.where(R.diagonal() < 0, -1.0, 1.0)[:, None] * R
    )
    return full


MOST_BLOCKS = 256
# singular value of scaled columns, over the largest, that counts as excited
RANK_TOLERANCE = 1e-3


@dataclass
class Accumulator:
    """Factors of one joint's equations with p parameters: `blocks` (p + 1, p + 1) of [H y]."""

    size: int
    blocks: list[Array] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)
    span: int = 1  # additions that a block takes
    filled: int = 1  # of them in the last one
    _total: Array | None = field(default=None, repr=False, compare=False)

    def add(self, H: Array, y: Array, where: Mask | None = None) -> None:
        """Add one block of rows H (N, p), y (N,), or those of them where a mask (N,) is true."""
        # An empty one keeps the joints' blocks in step. Cheapest with a column's
        # samples in a row.
        self._total = None
        rows = (
            np.vstack([H.T, y])
            if where is None
            else np.vstack([H.T[:, where], y[where]])
        )
        factor, count = triangular(rows.T), rows.shape[1]
        if self.blocks and self.filled < self.span:
            if count:
                self.blocks[-1] = triangular(np.vstack([self.blocks[-1], factor]))
            self.rows[-1] += count
            self.filled += 1
        else:
            self.blocks.append(factor)
            self.rows.append(count)
            self.filled = 1
        while len(self.blocks) > MOST_BLOCKS:
            self._halve()

    def __add__(self, other: "Accumulator") -> "Accumulator":
        first, second = copy(self), copy(other)
        for own in (first, second):  # blocks of one length
            while own.span < max(self.span, other.span):
                own._halve()
        blocks, rows = first.blocks + second.blocks, first.rows + second.rows
        both = Accumulator(self.size, blocks, rows, first.span, first.span)
        while len(both.blocks) > MOST_BLOCKS:
            both._halve()
        return both

    def _halve(self) -> None:
        """Merge each two neighbouring blocks; one without a partner stays."""
        if len(self.blocks) % 2 == 0:
            self.filled += self.span
        pairs = [self.blocks[i : i + 2] for i in range(0, len(self.blocks), 2)]
        self.blocks = [triangular(np.vstack(p)) if len(p) == 2 else p[0] for p in pairs]
        self.rows = [sum(self.rows[i : i + 2]) for i in range(0, len(self.rows), 2)]
        self.span *= 2

    @property
    def total(self) -> Array:
        """Factor of all rows, from the blocks in their order."""
        if self._total is None:
            self._total = triangular(
                np.vstack(self.blocks or [np.zeros((0, self.size + 1))])
            )
        return self._total

    @property
    def samples(self) -> int:
        """Number of rows added."""
        return sum(self.rows)

    def with_fixed(self, column: int, value: float) -> "Accumulator":
        """The same rows with one parameter held at a value and taken out."""
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
            self.size - 1, blocks, list(self.rows), self.span, self.filled, total
        )

    def residual_rms(self, theta: Array, fitted: int = 0) -> float:
        """RMS of H theta - y over all rows, but for so many that were `fitted`."""
        left = np.linalg.norm(self.total @ np.append(theta, -1.0))
        return float(left / np.sqrt(max(self.samples - fitted, 1)))


@dataclass(frozen=True)
class Prior:
    """What earlier stages know: rows A theta = b with unit variance, (k, p) and (k,)."""

    A: Array
    b: Array
    # By joint what b moves by with coefficients of friction (k, K_j), torque constants'
    # errors (k,)
    friction: dict[int, Array] = field(default_factory=dict)
    constants: dict[int, Array] = field(default_factory=dict)
    # likewise with what no log shows
    tolerances: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Solution:
    """Weighted least squares over all joints.

    `determined` (p,) is False for parameters that these data do not distinguish from
    others; their values are one choice among many (the smallest) and must not be
    reported. `left_open` (p, p - rank) are the directions along which nothing is known.
    """

    theta: Array
    covariance: Array
    determined: Mask
    rank: int
    condition: float
    sigma: Array  # residual RMS per joint
    bread: Array  # inverse of the weighted normal matrix
    left_open: Array
    moves: Array  # (G, p) by which the estimate moves without one block of time
    shares: Array  # (n, p) of the estimate that come from each joint's right side
    # (n,) variance that each joint's residual makes, over that of white noise
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
    white_floor: float = 0.05,
    nuisances: slice = slice(0, 0),
) -> Solution:
    """Solve for all joints together, each weighted by its own residual, with a block jackknife.

    `iterations`: rounds of reweighting. `independent`: share of the samples that count
    beside the prior: low-passed noise does not count more where there are more samples
    of it. `nuisances`: columns that the prior determines where the rows do not; rank
    and condition are of the others, these being marginalised.
    """
    size = joints[0].size
    totals = [joint.total for joint in joints]
    marginalised = len(range(*nuisances.indices(size)))
    fewest = (size - marginalised) // 4
    used = [k for k, joint in enumerate(joints) if joint.samples > fewest]
    # Each joint by itself first, not by R's last entry: rounding decides it where
    # columns depend.
    alone = [_solve_scaled(total)[:2] for total in totals]
    left = [
        j.residual_rms(x, B.shape[1]) for j, (x, B) in zip(joints, alone, strict=True)
    ]
    sigma = np.maximum(left, 1e-12)
    told = [] if prior is None else [np.column_stack([prior.A, prior.b])]
    known = [_seen(rows[:, :-1]) for rows in [*(totals[k] for k in used), *told]]
    seen = np.any(known, axis=0) if known else np.zeros(size, dtype=bool)
    for _ in range(iterations):
        # of the factor: what follows must use the same
        scale = sigma / np.sqrt(independent)
        stack = [totals[k] / scale[k] for k in used] + told
        factor = (
            triangular(np.vstack(stack)) if stack else np.zeros((size + 1, size + 1))
        )
        theta, basis, left_open, condition, determined = _solve_marginalised(
            factor, seen, nuisances
        )
        sigma = np.maximum([joint.residual_rms(theta) for joint in joints], 1e-12)
    rank = basis.shape[1] - marginalised
    bread = basis @ basis.T
    blocks = {k: joints[k].blocks for k in used}
    moves, designs = _jackknife(blocks, scale, theta, factor, bread)
    # A direction in which the blocks happen to agree is not known better than white
    # noise allows.
    covariance = spread_of(moves) + white_floor * bread
    if prior is not None:  # of unit variance: no residual to learn it from
        own = prior.A @ bread
        covariance += own.T @ own
    shares = np.zeros((len(joints), size))
    for k in used:
        shares[k] = bread @ (totals[k][:, :-1].T @ totals[k][:, -1]) / scale[k] ** 2
    found = theta, covariance, determined, rank, condition
    return Solution(*found, sigma, bread, left_open, moves, shares, designs)


def _seen(rows: Array) -> Mask:
    """Columns of rows (k, p) of one noise that hold more than rounding."""
    norms = np.linalg.norm(rows, axis=0)
    return np.asarray(norms > 1e-9 * norms.max(initial=1e-300))


def _solve_scaled(
    factor: Array, seen: Mask | None = None
) -> tuple[Array, Array, Array, float, Mask]:
    """Smallest solution with scaled columns, of those that are `seen` (p,)."""
    # Then B with (H'H)^+ = B B' over what is excited, the directions that are not, the
    # condition, and which parameters have no part in those directions.
    R, z = factor[:-1, :-1], factor[:-1, -1]
    scale = np.linalg.norm(R, axis=0)
    scale[~(_seen(R) if seen is None else seen)] = np.inf
    U, s, Vt = np.linalg.svd(R / scale)
    kept = s > RANK_TOLERANCE * s[0] if s[0] > 0 else np.zeros(len(s), dtype=bool)
    basis = (Vt[kept].T / s[kept]) / scale[:, None]
    condition = float(s[kept][0] / s[kept][-1]) if kept.any() else 0.0
    left_open = Vt[~kept].T / np.where(np.isfinite(scale), scale, 1.0)[:, None]
    determined: Mask = np.isfinite(scale) & (np.sum(Vt[kept] ** 2, axis=0) > 1 - 1e-4)
    return basis @ (U[:, kept].T @ z), basis, left_open, condition, determined


def _solve_marginalised(
    factor: Array, seen: Mask, nuisances: slice
) -> tuple[Array, Array, Array, float, Mask]:
    """Solve as `_solve_scaled` does, which directions are excited being asked of the others alone.

    A nuisance term that resembles a parameter is told apart by its prior, however weak
    that is beside the rows: it is no direction to be dropped.
    """
    columns = np.arange(len(factor) - 1)
    first = columns[nuisances]
    if not len(first):
        return _solve_scaled(factor, seen)

    # With the nuisances first, the rows below theirs are of what they leave of the
    # others.
    others = np.setdiff1d(columns, first)
    ordered = factor[:, [*first, *others, len(columns)]]
    R = np.asarray(np.linalg.qr(ordered, mode="r"), dtype=np.float64)
    count = len(first)
    theta_rest, basis_rest, open_rest, condition, determined_rest = _solve_scaled(
        R[count:, count:], seen[others]
    )
    inner = R[:count, :count]
    across = R[:count, count:-1]

    size, rank = len(columns), basis_rest.shape[1]
    theta = np.zeros(size)
    theta[others] = theta_rest
    theta[first] = np.linalg.solve(inner, R[:count, -1] - across @ theta_rest)
    basis = np.zeros((size, count + rank))
    basis[np.ix_(others, np.arange(count, count + rank))] = basis_rest
    basis[first, :count] = np.linalg.inv(inner)
    basis[first, count:] = -np.linalg.solve(inner, across @ basis_rest)
    left_open = np.zeros((size, open_rest.shape[1]))
    left_open[others] = open_rest
    determined = np.ones(size, dtype=np.bool_)
    determined[others] = determined_rest
    return theta, basis, left_open, condition, determined


def _jackknife(
    blocks: dict[int, list[Array]],
    sigma: Array,
    theta: Array,
    factor: Array,
    bread: Array,
) -> tuple[Array, Array]:
    """Moves (G, p) of the estimate when one block of time is left out, and designs (n,)."""
    # With G blocks of normal matrix A_b and score s_b the estimate without block b
    # moves by (A - A_b)^-1 s_b; the covariance is the sum of squares of these moves.
    # Unlike the sandwich it does not shrink when a block has leverage. The scores of
    # one joint alone, over what white noise would make of them, are its design effect.
    normal = factor[:-1, :-1].T @ factor[:-1, :-1]
    count = max(map(len, blocks.values()), default=0)
    A, s = np.zeros((count, *bread.shape)), np.zeros((len(sigma), count, len(theta)))
    designs = np.ones(len(sigma))
    for k, factors in blocks.items():
        R = np.stack(factors) / sigma[k]
        inner, own = R[:, :, :-1].transpose(0, 2, 1), slice(len(R))
        normals = inner @ R[:, :, :-1]
        A[own] += normals
        s[k, own] = (inner @ (R @ np.append(-theta, 1.0))[:, :, None])[:, :, 0]
        white = np.trace(bread @ normals.sum(axis=0))
        designs[k] = np.sum((s[k] @ bread) * s[k]) / max(white, 1e-300)
    scores = s.sum(axis=0)
    # (A - A_b)^+ s_b within the excited directions; the plain score where that is not
    # regular.
    plain, left = scores @ bread, np.eye(len(bread)) - bread @ A
    try:
        moves = np.linalg.solve(left, plain[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        moves = (np.linalg.pinv(left) @ plain[:, :, None])[:, :, 0]
    before, after = (
        np.einsum("bi,ij,bj->b", x, normal, x).clip(0.0) for x in (plain, moves)
    )
    regular: Mask = np.sqrt(after) <= 4.0 * np.sqrt(before)
    moves = np.where(regular[:, None], moves, plain)
    # Few blocks: what the fit itself has taken of their residuals.
    leverage = np.sum((moves @ normal) * moves) / max(np.sum(plain * scores), 1e-300)
    return moves, designs * leverage


def spread_of(moves: Array) -> Array:
    """Covariance (p, p) by the jackknife's moves (G, p)."""
    count = len(moves)
    return np.asarray(moves.T @ moves * (max(count - 1, 1) / max(count, 1)))


def whitened(covariance: Array) -> Array:
    """Rows L with L' L the (pseudo-)inverse of a covariance: a stage's result as a prior."""
    value, vector = np.linalg.eigh((covariance + covariance.T) / 2)
    kept = value > 1e-14 * max(value.max(initial=0.0), 1e-300)
    return np.asarray((vector[:, kept] / np.sqrt(value[kept])).T)
