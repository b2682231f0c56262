"""A Gaussian linear model of all rows, its evidence, and how well it predicts blocks left out.

Rows y of a channel (a joint's torque below the cut-off, or above it) are

    y = B theta + e,   theta ~ N(0, P^-1),   e ~ N(0, 1 / w),

with the precision w of each row. A term with columns X and coefficients a ~ N(0, Q^-1)
raises the log evidence by

    E = d' (Q + D)^-1 d / 2 - log det(I + Q^-1 D) / 2,
    D = X'wX - X'wB M^-1 B'wX,   d = X'w (y - B M^-1 B'wy),   M = P + B'wB,

and the log density that all other blocks predict for block b by E - E without b. All of
it follows from products block by block: no fit is repeated. What a parameter file says
of the base is a block as well: a base that is free enough takes up a constant effect at
the price of leaving the file, and E - E without the file is what the term saves of it.
Of an effect that was there when the file was identified the file has R a in its base:
theta + R a ~ N(0, P^-1) then, which couples the two.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, repeat

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from seqid_cli.discover.select import algebra
from seqid_cli.discover.select.rows import ColumnGroup, Observations, Score, TermFit
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Index

BATCH = 200  # terms that are tried at once
Solved = tuple[algebra.Factor, Array]  # factor and parameters (p,)


class LinearModel:
    """Parts of a model, fitted to rows of precision `weight` (M_c,) [1 / (N m)^2] by channel."""

    def __init__(
        self, rows: Observations, parts: Sequence[ColumnGroup], weight: Sequence[Array]
    ) -> None:
        self.rows, self.parts, self.weight = rows, tuple(parts), tuple(weight)
        self.where = _slices(part.size for part in self.parts)
        self.size = sum(part.size for part in self.parts)
        self._own = list(map(self._of_channel, range(len(rows.y))))
        self._known: dict[int, tuple[TermFit, Score]] = {}  # by parts of the model

    @cached_property
    def _root(self) -> list[Array]:
        return [np.sqrt(w) for w in self.weight]

    @cached_property
    def _y(self) -> list[Array]:
        return [y * root for y, root in zip(self.rows.y, self._root, strict=True)]

    def without(self, *gone: ColumnGroup) -> LinearModel:
        """The model without some of its parts; the products of all rows are taken on."""
        kept = [
            k
            for k, part in enumerate(self.parts)
            if not any(part is one for one in gone)
        ]
        index = np.concatenate([np.arange(self.size)[self.where[k]] for k in kept])
        A, b = self.sums
        fewer = LinearModel(self.rows, [self.parts[k] for k in kept], self.weight)
        fewer.sums = A[np.ix_(index, index)], b[index]
        return fewer

    def _of_channel(self, channel: int) -> tuple[Index, list[Array]]:
        """Parameters (p_c,) that a channel knows, and its columns (M_c, .), part by part."""
        here = [
            (
                np.arange(where.start, where.stop)[part.at(channel)],
                part.columns[channel],
            )
            for part, where in zip(self.parts, self.where, strict=True)
            if channel in part.columns
        ]
        index = np.concatenate([np.zeros(0, dtype=np.intp), *(own for own, _ in here)])
        return index, [columns for _, columns in here]

    def _blocks(self, *, file: bool = True) -> Array:
        """Precision (p, p) beforehand of what is `held`, with or without what the file says."""
        P = np.zeros((self.size, self.size))
        for part, where in zip(self.parts, self.where, strict=True):
            P[where, where] = (
                part.precision
                if file or part.precision_without_file is None
                else part.precision_without_file
            )
        return P

    def in_file(self, part: ColumnGroup) -> Array:
        """Parameters (p, k) that the file has per unit of a part's coefficients."""
        R = np.zeros((self.size, part.size))
        for number, own in part.absorbed_by_file.items():
            first = self.where[number].start
            R[first : first + len(own), : own.shape[1]] = own
        return R

    @cached_property
    def lift(self) -> Array:
        """The matrix (p, p) that makes of parameters what is held: they and what the file has."""
        U = np.eye(self.size)
        for part, where in zip(self.parts, self.where, strict=True):
            if part.absorbed_by_file:
                U[:, where] += self.in_file(part)
        return U

    @property
    def held(self) -> Array:
        """Parameters (p,) and what the file has absorbed of terms, which are held to the file."""
        return np.asarray(self.lift @ self.theta)

    def _coupled(self, held: Array) -> Array:
        """Precision (p, p) of the parameters, from that of what is held."""
        coupled = any(part.absorbed_by_file for part in self.parts)
        return np.asarray(self.lift.T @ held @ self.lift) if coupled else held

    @cached_property
    def prior(self) -> Array:
        """Precision (p, p) of all parameters beforehand."""
        return self._coupled(self._blocks())

    def _sums_of(self, rows: Sequence[slice]) -> tuple[Array, Array]:
        """B'wB (p, p) and B'wy (p,) of some rows of every channel."""
        A, b = np.zeros((self.size, self.size)), np.zeros(self.size)
        for (index, columns), root, y, at in zip(
            self._own, self._root, self._y, rows, strict=True
        ):
            B = _times(root[at], [own[at] for own in columns])
            A[np.ix_(index, index)] += B.T @ B
            b[index] += B.T @ y[at]
        return A, b

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """The same of all rows."""
        return self._sums_of([slice(None)] * len(self._own))

    @cached_property
    def _scale(self) -> Array:
        return algebra.scale_of(np.diag(self.prior) + np.diag(self.sums[0]))

    def _fit(self, A: Array, b: Array) -> Solved:
        """Factor and solution (p,) from B'wB and B'wy."""
        factor = algebra.factored((A + self.prior) * np.outer(self._scale, self._scale))
        return factor, self._solved(factor, b)

    def _solved(self, factor: algebra.Factor, right: Array) -> Array:
        scale = self._scale[:, None] if right.ndim == 2 else self._scale
        return np.asarray(cho_solve(factor, right * scale, check_finite=False) * scale)

    def _halved(self, factor: algebra.Factor, right: Array) -> Array:
        """R^-T right (p, k) of a factor R: the square of it is right' M^-1 right."""
        scaled = right * self._scale[:, None]
        return np.asarray(
            solve_triangular(factor[0], scaled, trans="T", check_finite=False)
        )

    @cached_property
    def _whole(self) -> Solved:
        return self._fit(*self.sums)

    @cached_property
    def _without(self) -> list[Solved]:
        """Factor and solution (p,) without each block."""
        A, b = self.sums
        blocks = map(self._sums_of, zip(*self.rows.at, strict=True))
        return [self._fit(A - own_A, b - own_b) for own_A, own_b in blocks]

    @cached_property
    def _without_file(self) -> Solved:
        """Factor and solution (p,) without what the parameter file says."""
        A, b = self.sums
        return self._fit(A + self._coupled(self._blocks(file=False)) - self.prior, b)

    @property
    def theta(self) -> Array:
        """Parameters (p,) given all rows."""
        return self._whole[1]

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, p) of `theta`."""
        return self._solved(self._whole[0], np.eye(self.size))

    def _at(self, part: ColumnGroup) -> slice:
        return next(w for p, w in zip(self.parts, self.where, strict=True) if p is part)

    def jackknife(self, at: slice) -> Array:
        """Covariance (k, k) of some of `theta`, from leaving out each block."""
        values = np.array([theta[at] for _, theta in self._without])
        off = values - values.mean(axis=0)
        return np.asarray((1.0 - 1.0 / len(values)) * off.T @ off)

    def again(self, part: ColumnGroup) -> tuple[TermFit, Score]:
        """What a part of the model does beside all others, as it was tried before it was taken.

        The log Bayes factor is the density of its coefficients at zero, beforehand over
        given the rows (Savage's ratio: J. M. Dickey, Annals of Mathematical Statistics
        42, 1971).
        """
        if id(part) not in self._known:
            at = self._at(part)
            solved = [
                (theta[at], self._solved(factor, np.eye(self.size)[:, at])[at])
                for factor, theta in (self._whole, self._without_file, *self._without)
            ]
            value, alone, *others = (
                algebra.taken_back(a, S, part.precision) for a, S in solved
            )
            rows, (a, S) = (
                self.rows.independent[sorted(part.columns)].sum(axis=0),
                solved[0],
            )
            seen = np.trace(np.linalg.inv(S) - part.precision)
            visible = float(seen / max(float(np.trace(self.sums[0][at, at])), 1e-300))
            told = Score(value - np.array(others), rows, value - alone)
            self._known[id(part)] = TermFit(value, a, S, max(visible, 0.0)), told
        return self._known[id(part)]

    def varied(self, part: ColumnGroup, *, spread: float = 0.3) -> float:
        """Log evidence that a part has another size in every block, by a share of `spread`."""
        at, blocks = self._at(part), self.rows.blocks
        C, D, d = np.zeros((self.size, blocks)), np.zeros(blocks), np.zeros(blocks)
        for c in part.columns:
            (index, known), torque = self._own[c], part.torque(c, self.theta[at])
            weighted, left = (
                torque * self.weight[c],
                self._left(c, slice(None), self.theta),
            )
            for k, rows in enumerate(self.rows.at[c]):
                C[index, k] += np.concatenate(
                    [own[rows].T @ weighted[rows] for own in known]
                )
                D[k] += torque[rows] @ weighted[rows]
                d[k] += left[rows] @ weighted[rows]
        Z = self._halved(self._whole[0], C)
        return float(
            algebra.bayes_factor(np.diag(D) - Z.T @ Z, d, np.eye(blocks) / spread**2)[0]
        )

    @cached_property
    def evidence(self) -> float:
        """Log density of the rows, their weights' part aside."""
        factor, theta = self._whole
        scaled = self._blocks() * np.outer(self._scale, self._scale)
        before = sum(
            algebra.half_log_det(algebra.factored(scaled[at, at])) for at in self.where
        )
        square = sum(float(y @ y) for y in self._y)
        return (
            0.5 * (float(self.sums[1] @ theta) - square)
            - algebra.half_log_det(factor)
            + before
        )

    def residual(self) -> list[Array]:
        """What is left (M_c,) N m of every channel."""
        return [self._left(c, slice(None), self.theta) for c in range(len(self._y))]

    @cached_property
    def left_out(self) -> list[Array]:
        """The same of every block where the model is fitted to all others."""
        fits, every = [theta for _, theta in self._without], enumerate(self.rows.at)
        return [
            np.concatenate([*map(self._left, repeat(c), at, fits)]) for c, at in every
        ]

    def torque_beside_file(self, part: ColumnGroup, channel: int) -> Array:
        """Torque (M_c,) N m of a part at a channel less what the file has absorbed of it."""
        own = self._at(part)
        theta = -self.in_file(part) @ self.theta[own]
        theta[own] = self.theta[own]
        return self.rows.y[channel] - self._left(channel, slice(None), theta)

    def _left(self, channel: int, at: slice, theta: Array) -> Array:
        index, columns = self._own[channel]
        left, first = self.rows.y[channel][at].copy(), 0
        for own in columns:
            left -= own[at] @ theta[index[first : first + own.shape[1]]]
            first += own.shape[1]
        return left

    def fits(self, terms: Sequence[ColumnGroup]) -> list[TermFit]:
        """Try each term by itself."""
        found = []
        for first in range(0, len(terms), BATCH):
            every = [(slice(0, len(y)),) for y in self._y]
            crossed = self._crossed(terms[first : first + BATCH], every)
            found += self._given(self._whole, crossed, self._with_file(crossed))
        return found

    def scores(self, terms: Sequence[ColumnGroup]) -> list[Score]:
        """Try each term by itself on every block, all fitted to the other blocks."""
        if not terms:
            return []
        crossed = self._crossed(terms, self.rows.at)
        told, apart = (self._with_file(crossed, file=x) for x in (True, False))
        every = self._given(self._whole, crossed, told)
        alone = self._given(self._without_file, crossed, apart)
        (C, whole), (_, d, _) = told, crossed.whole
        # of the columns, by the base without a block
        seen = [np.empty_like(D) for D in crossed.D]
        left = np.empty_like(crossed.d)
        for k, (factor, theta) in enumerate(self._without):
            rest = C - crossed.C[k]
            Z, left[k] = self._halved(factor, rest), d - crossed.d[k] - rest.T @ theta
            for S, at in zip(seen, crossed.where, strict=True):
                S[k] = Z[:, at].T @ Z[:, at]
        rows, found = self.rows.independent, list[Score]()
        for i, (term, at, own) in enumerate(
            zip(terms, crossed.where, crossed.D, strict=True)
        ):
            others = algebra.bayes_factor(
                whole[i] - own - seen[i], left[:, at], term.precision
            )[0]
            density, here = (
                every[i].log_bayes_factor - others,
                rows[sorted(term.columns)].sum(axis=0),
            )
            found.append(
                Score(
                    density, here, every[i].log_bayes_factor - alone[i].log_bayes_factor
                )
            )
        return found

    def _with_file(
        self, crossed: _Crossed, *, file: bool = True
    ) -> tuple[Array, list[Array]]:
        """C (p, m) and D (k, k) of all blocks and of what is held, with or without the file."""
        C, _, whole = crossed.whole
        if not any(term.absorbed_by_file for term in crossed.terms):
            return C, whole
        R = np.hstack([self.in_file(term) for term in crossed.terms])
        PR = self._blocks(file=file) @ R
        own = [
            D + R[:, at].T @ PR[:, at]
            for D, at in zip(whole, crossed.where, strict=True)
        ]
        return C + self.lift.T @ PR, own

    def _given(
        self, solved: Solved, crossed: _Crossed, told: tuple[Array, list[Array]]
    ) -> list[TermFit]:
        """What each term by itself does to a solved model, with the products C and D."""
        (factor, theta), (C, coupled), (_, d, whole) = solved, told, crossed.whole
        Z, left = self._halved(factor, C), d - C.T @ theta
        found = []
        for term, at, D, own in zip(
            crossed.terms, crossed.where, coupled, whole, strict=True
        ):
            S = D - Z[:, at].T @ Z[:, at]
            value, a, covariance = algebra.bayes_factor(S, left[at], term.precision)
            visible = float(np.trace(S) / max(float(np.trace(own)), 1e-300))
            found.append(TermFit(float(value), a, covariance, max(visible, 0.0)))
        return found

    def _crossed(
        self, terms: Sequence[ColumnGroup], at: Sequence[Sequence[slice]]
    ) -> _Crossed:
        """Products of terms with all else, over some slices of each channel's rows."""
        where = _slices(term.size for term in terms)
        count, wide = len(at[0]), where[-1].stop
        C, d = np.zeros((count, self.size, wide)), np.zeros((count, wide))
        D = [np.zeros((count, term.size, term.size)) for term in terms]
        first = dict[tuple[int, ...], int]()  # one of the terms with the same columns
        keys = [(term.size, *map(id, term.columns.values())) for term in terms]
        same = [first.setdefault(key, i) for i, key in enumerate(keys)]
        for c, (index, known) in enumerate(self._own):
            here = [i for i in first.values() if c in terms[i].columns]
            if not here:
                continue
            places = [
                np.arange(where[i].start, where[i].stop)[terms[i].at(c)] for i in here
            ]
            columns, edge = (
                np.concatenate(places),
                np.cumsum([len(own) for own in places])[:-1],
            )
            square = np.ix_(index, columns)
            for k, rows in enumerate(at[c]):
                for part in tiles(rows.stop, rows.start):
                    every = [terms[i].columns[c][part] for i in here]
                    wX = _times(self.weight[c][part], every)
                    if known:  # none above a cut-off
                        C[k][square] += np.vstack([B[part].T @ wX for B in known])
                    d[k, columns] += self.rows.y[c][part] @ wX
                    for i, X, own in zip(
                        here, every, np.split(wX, edge, axis=1), strict=True
                    ):
                        at_c = terms[i].at(c)
                        D[i][k, at_c, at_c] += X.T @ own
        for i, other in ((i, other) for i, other in enumerate(same) if other != i):
            C[:, :, where[i]], d[:, where[i]] = (
                C[:, :, where[other]],
                d[:, where[other]],
            )
            D[i] = D[other]
        return _Crossed(terms, where, C, d, D)


@dataclass(frozen=True)
class _Crossed:
    """Products of terms with the model's columns, the rows and themselves, block by block."""

    terms: Sequence[ColumnGroup]
    where: list[slice]
    C: Array  # (blocks, p, m)
    d: Array  # (blocks, m)
    D: list[Array]  # (blocks, k, k) of each term

    @cached_property
    def whole(self) -> tuple[Array, Array, list[Array]]:
        """C (p, m), d (m,) and D (k, k) of all blocks."""
        return (
            self.C.sum(axis=0),
            self.d.sum(axis=0),
            [own.sum(axis=0) for own in self.D],
        )


def _slices(sizes: Iterable[int]) -> list[slice]:
    """Places of so many numbers each, one after the other."""
    edges: list[int] = np.cumsum([0, *sizes]).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


def _times(root: Array, columns: Sequence[Array]) -> Array:
    """Columns (M, k) each, side by side and times root (M,)."""
    result = np.empty((len(root), sum(own.shape[1] for own in columns)))
    for own, at in zip(columns, _slices(own.shape[1] for own in columns), strict=True):
        np.multiply(own, root[:, None], out=result[:, at])
    return result
