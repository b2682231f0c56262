"""Normal equations of base and accepted effects, fold by fold; candidates are tried against them.

With base columns B, a candidate's columns X, and A = B'B, the candidate projected off the base is
X - B Z, A Z = B'X (Frisch, Waugh, Lovell): whatever the base can absorb of it does not count. Every
fold is left out in turn; what counts is by how much the candidate lowers the squared residual
there, in units of each joint's own noise.

    gain_f = 2 a'(X - B Z)'r - a'(X - B Z)'(X - B Z) a      on fold f, Z, a, r from the others.

All of it follows from Gram matrices of the folds: one pass over the rows, then a small product per
candidate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from seqid_cli.discover.gains import Trained, gains_of, inverse_of, single_gains
from seqid_cli.discover.rows import Rows
from seqid_cli.discover.wide import HighBand

Array = NDArray[np.float64]
Index = NDArray[np.intp]

FLOOR_OF_WHITE = 0.05  # of the white-noise covariance, below which no direction is known
RIDGE = 1e-9  # of a scaled column's square: keeps directions that these logs leave open harmless
LEAST_STEADY = 1.3  # 1 where a single fold makes the whole gain, sqrt(folds) where all share it
SHARED = 6.0  # folds that must share a gain; one of fewer must be larger by as much
Joints = Mapping[int, Array]  # joint -> its rows of some columns (M_j, k)


@dataclass(frozen=True)
class Block:
    """Columns that are fitted together: joint -> (M_j, k), and rows of unit variance about them."""

    columns: Joints
    prior: Array  # (m, k)
    lasting: bool = False  # the same arrays in every system of these rows: products are kept

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(next(iter(self.columns.values())).shape[1])


@dataclass(frozen=True)
class Trial:
    """What one candidate does.

    `gain` (F,) per fold and `loss` (F,) of the base there, both in units of noise variance;
    `visible` the share of the columns' length that the base leaves; `coefficients` (k,) and their
    white-noise covariance over all folds; `relative` the gain as a share of the loss of the joints
    that the candidate touches, `joints` their number.
    """

    gain: Array
    loss: Array
    visible: float
    coefficients: Array
    covariance: Array
    relative: float
    joints: int = 1

    @property
    def total(self) -> float:
        """Gain over all folds."""
        return float(self.gain.sum())

    @property
    def steadiness(self) -> float:
        """Gain over the root of the folds' summed squares: noise scatters about zero."""
        return self.total / max(float(np.linalg.norm(self.gain)), 1e-300)

    @property
    def scarcity(self) -> float:
        """Times by which the gain must be larger because few folds share it."""
        return max(1.0, SHARED / max(self.steadiness, LEAST_STEADY) ** 2)


class System:
    """Base blocks and the residual of every joint, ready for candidates.

    Parameters
    ----------
    rows : Rows
    y : sequence of (M_j,) arrays
        What is to be explained, N m.
    noise : sequence of (M_j,) arrays
        Standard deviation that each row is divided by, N m.
    blocks : sequence of Block
        The base.
    high : HighBand, optional
        Rows above the cut-off, as channels n to 2 n - 1 of `y` and `noise`.
    """

    def __init__(
        self,
        rows: Rows,
        y: Sequence[Array],
        noise: Sequence[Array],
        blocks: Sequence[Block],
        high: HighBand | None = None,
    ) -> None:
        self.rows, self.y, self.noise, self.high = rows, tuple(y), tuple(noise), high
        self.blocks = tuple(blocks)
        edges = np.cumsum([0] + [block.size for block in self.blocks])
        self.where = [slice(int(a), int(b)) for a, b in pairwise(edges)]
        self.size = int(edges[-1])
        self.folds = int(np.max(rows.fold)) + 1
        above = () if high is None else high.fold
        self._fold_of = [*(rows.folds_of(j) for j in range(rows.n)), *above]
        self._local = [self._of_joint(j) for j in range(len(self._fold_of))]

    def _of_joint(self, joint: int) -> tuple[Index, Array]:
        """Global indices (p_j,) and scaled columns (M_j, p_j) of one joint's base."""
        index, parts = [np.zeros(0, dtype=np.intp)], [np.zeros((len(self.y[joint]), 0))]
        for block, where in zip(self.blocks, self.where, strict=True):
            if joint in block.columns:
                index.append(np.arange(where.start, where.stop))
                parts.append(block.columns[joint])
        return np.concatenate(index), np.hstack(parts) / self.noise[joint][:, None]

    def instead(self, joint: int, y: Array) -> System:
        """The same system with other rows (M_j,) N m to be explained at one joint."""
        every = [y if j == joint else own for j, own in enumerate(self.y)]
        return System(self.rows, every, self.noise, self.blocks, self.high)

    @cached_property
    def grams(self) -> tuple[Array, Array, Array]:
        """A (F, p, p), b (F, p) and y'y (F, n) of every fold."""
        A = np.zeros((self.folds, self.size, self.size))
        b, yy = np.zeros((self.folds, self.size)), np.zeros((self.folds, len(self.y)))
        for j in range(len(self.y)):
            weight = 1.0 / float(self.noise[j][0]) ** 2 if len(self.noise[j]) else 0.0
            y = self.y[j]
            yy[:, j] = weight * self._product(j, y, y, kept=True)
            own = [
                (block.columns[j], where, block.lasting)
                for block, where in zip(self.blocks, self.where, strict=True)
                if j in block.columns
            ]
            for k, (X, at, lasting) in enumerate(own):
                b[:, at] += weight * self._product(j, X, y, kept=lasting)
                for Z, other, also in own[k:]:
                    product = weight * self._product(j, X, Z, kept=lasting and also)
                    A[:, at, other] += product
                    if other != at:
                        A[:, other, at] += product.transpose(0, 2, 1)
        return A, b, yy

    def _product(self, joint: int, X: Array, Z: Array, *, kept: bool) -> Array:
        """X'Z (F, k, l) of every fold, unscaled; a vector is one column without its axis."""
        products = self.rows.made.setdefault("products", {})
        assert isinstance(products, dict)
        key = (joint, id(X), id(Z))
        if key in products:
            found: Array = products[key][2]
            return found
        result = np.stack([X[at].T @ Z[at] for at in self._folds_at[joint]])
        if kept:
            products[key] = (X, Z, result)  # with the arrays, so that their ids stay theirs
        return result

    @cached_property
    def _folds_at(self) -> list[list[slice | Index]]:
        """Rows of each fold, joint by joint; slices where the folds follow each other."""
        return [_places(fold, self.folds) for fold in self._fold_of]

    @cached_property
    def prior(self) -> Array:
        """Precision (p, p) of what is known of the base."""
        P = np.zeros((self.size, self.size))
        for block, where in zip(self.blocks, self.where, strict=True):
            P[where, where] += block.prior.T @ block.prior
        return P

    @cached_property
    def _scale(self) -> Array:
        diagonal = np.diag(self.grams[0].sum(axis=0) + self.prior).copy()
        diagonal[diagonal <= 0] = 1.0
        return np.sqrt(diagonal)

    def _factor(self, A: Array) -> tuple[Array, bool]:
        scaled = (A + self.prior) / np.outer(self._scale, self._scale)
        scaled[np.diag_indices(self.size)] += RIDGE
        return cho_factor(scaled, check_finite=False)

    def _solved(self, factor: tuple[Array, bool], right: Array) -> Array:
        scale = self._scale[:, None] if right.ndim == 2 else self._scale
        solved: Array = cho_solve(factor, right / scale, check_finite=False) / scale
        return solved

    @cached_property
    def _trained(self) -> list[tuple[tuple[Array, bool], Array]]:
        """Per fold: factor of all other folds, and the base's solution (p,) from them."""
        A, b, _ = self.grams
        total_A, total_b = A.sum(axis=0), b.sum(axis=0)
        result = []
        for f in range(self.folds):
            factor = self._factor(total_A - A[f])
            result.append((factor, self._solved(factor, total_b - b[f])))
        return result

    @cached_property
    def _whole(self) -> tuple[tuple[Array, bool], Array]:
        A, b, _ = self.grams
        factor = self._factor(A.sum(axis=0))
        return factor, self._solved(factor, b.sum(axis=0))

    @property
    def theta(self) -> Array:
        """Solution (p,) of the base over all folds."""
        return self._whole[1]

    @cached_property
    def covariance(self) -> Array:
        """White-noise covariance (p, p) of `theta`."""
        return self._solved(self._whole[0], np.eye(self.size))

    def block_covariance(self) -> Array:
        """Covariance (p, p) of `theta` from the scatter of the blocks' scores.

        Holds for residuals that are correlated within a block of time.
        """
        bread = self.covariance
        scores = np.zeros((len(self.rows.fold), self.size))
        for j, (index, X) in enumerate(self._local[: self.rows.n]):
            r = self.y[j] / self.noise[j] - X @ self.theta[index]
            at = self.rows.blocks_of(j)
            own = np.zeros((len(self.rows.fold), len(index)))
            np.add.at(own, at, X * r[:, None])
            scores[:, index] += own
        return bread @ (scores.T @ scores) @ bread + FLOOR_OF_WHITE * bread

    @cached_property
    def loss(self) -> Array:
        """Squared residual (F, n) of each fold and joint under the base fitted to the others."""
        per_joint = [
            np.bincount(fold, weights=r**2, minlength=self.folds)
            for r, fold in zip(self.left_out(), self._fold_of, strict=True)
        ]
        return np.stack(per_joint, axis=1)

    def left_out(self) -> list[Array]:
        """Scaled residual (M_j,) of every joint's rows, the base fitted to the other folds."""
        result = []
        for j, (index, X) in enumerate(self._local):
            y = self.y[j] / self.noise[j]
            thetas = np.array([theta[index] for _, theta in self._trained])
            result.append(y - np.einsum("mp,mp->m", X, thetas[self._fold_of[j]]))
        return result

    def residual(self) -> list[Array]:
        """Residual (M_j,) N m of every joint's rows under the base fitted to all of them."""
        return [
            y - noise * (X @ self.theta[index])
            for y, noise, (index, X) in zip(self.y, self.noise, self._local, strict=True)
        ]

    def beside(self, candidate: Joints) -> dict[int, tuple[Array, Array]]:
        """Rows of a candidate (M_j, k) projected off the base, and the residual (M_j,), scaled."""
        width = next(iter(candidate.values())).shape[1]
        scaled = {j: X / self.noise[j][:, None] for j, X in candidate.items()}
        crossed = np.zeros((self.size, width))
        for j, X in scaled.items():
            index, B = self._local[j]
            crossed[index] += B.T @ X
        Z = self._solved(self._whole[0], crossed)
        left = self.residual()
        return {
            j: (X - self._local[j][1] @ Z[self._local[j][0]], left[j] / self.noise[j])
            for j, X in scaled.items()
        }

    def tried(self, candidates: Sequence[Joints], held: Sequence[float] = ()) -> list[Trial]:
        """Try each candidate by itself against the base.

        `held` is the precision with which each one's coefficients are known to be about zero: it
        keeps those small which the rows of some folds leave open. Default: not at all.
        """
        held = held or [0.0] * len(candidates)
        if not candidates:
            return []
        sizes = [next(iter(c.values())).shape[1] for c in candidates]
        edges = np.cumsum([0, *sizes])
        where = [slice(int(a), int(b)) for a, b in pairwise(edges)]
        C, own = self._crossed(candidates, where, int(edges[-1]))
        A, b, _ = self.grams
        total_C = C.sum(axis=0)
        whole, theta = self._whole
        Z = self._solved(whole, total_C)
        trained = []
        for f, (factor, solution) in enumerate(self._trained):
            Zf = self._solved(factor, total_C - C[f])
            AZ = A[f] @ Zf
            trained.append((Zf, AZ, solution, b[f] - A[f] @ solution, total_C - C[f]))
        single = [i for i, size in enumerate(sizes) if size == 1]
        alone = np.array([where[i].start for i in single], dtype=np.intp)
        D = np.array([own[i][0][:, 0, 0] for i in single]).reshape(len(single), self.folds)
        d = np.array([own[i][1][:, 0] for i in single]).reshape(len(single), self.folds)
        own_held = np.array([held[i] for i in single])
        singles = single_gains(D, d, C[:, :, alone], trained, alone, own_held)
        gains = dict(zip(single, singles, strict=True))
        return [
            self._trial(c, w, D, d, C, Z, theta, trained, gains.get(i), held[i])
            for i, (c, w, (D, d)) in enumerate(zip(candidates, where, own, strict=True))
        ]

    def _crossed(
        self, candidates: Sequence[Joints], where: Sequence[slice], width: int
    ) -> tuple[Array, list[tuple[Array, Array]]]:
        """B'X (F, p, width) and each candidate's own X'X (F, k, k) and X'y (F, k)."""
        C = np.zeros((self.folds, self.size, width))
        own = [
            (
                np.zeros((self.folds, w.stop - w.start, w.stop - w.start)),
                np.zeros((self.folds, w.stop - w.start)),
            )
            for w in where
        ]
        for j, (index, B) in enumerate(self._local):
            here = [i for i, c in enumerate(candidates) if j in c]
            if not here:
                continue
            X = np.hstack([candidates[i][j] for i in here]) / self.noise[j][:, None]
            at_global = np.concatenate([np.arange(where[i].start, where[i].stop) for i in here])
            y = self.y[j] / self.noise[j]
            for f, at in enumerate(self._folds_at[j]):
                Xf, yf = X[at], y[at]
                C[f][np.ix_(index, at_global)] += B[at].T @ Xf
                first = 0
                for i in here:
                    part = Xf[:, first : first + where[i].stop - where[i].start]
                    own[i][0][f] += part.T @ part
                    own[i][1][f] += part.T @ yf
                    first += part.shape[1]
        return C, own

    def _trial(
        self,
        candidate: Joints,
        where: slice,
        D: Array,
        d: Array,
        C: Array,
        Z: Array,
        theta: Array,
        trained: Sequence[Trained],
        gain: Array | None,
        held: float,
    ) -> Trial:
        total_D = D.sum(axis=0)
        total_C = C[:, :, where].sum(axis=0)
        S = total_D - total_C.T @ Z[:, where]
        length = max(float(np.trace(total_D)), 1e-300)
        visible = float(np.sqrt(max(np.trace(S), 0.0) / length))
        inverse = inverse_of(S + held * np.eye(len(S)), total_D)
        a = inverse @ (d.sum(axis=0) - total_C.T @ theta)
        if gain is None:
            gain = gains_of(D, d, C[:, :, where], trained, where, held)
        touched = [j for j in sorted(candidate) if j < self.rows.n]
        loss = self.loss[:, touched].sum(axis=1)
        relative = float(gain.sum() / max(loss.sum(), 1e-300))
        return Trial(gain, loss, visible, a, inverse, relative, len(touched))


def _places(fold: Index, folds: int) -> list[slice | Index]:
    if np.all(np.diff(fold) >= 0):
        edges = np.searchsorted(fold, np.arange(folds + 1))
        return [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return [np.flatnonzero(fold == f) for f in range(folds)]
