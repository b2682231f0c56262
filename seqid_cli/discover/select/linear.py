"""A Gaussian linear model of all rows, its evidence, and scores on left-out blocks.

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

In the code A is B'wB, b is B'wy and C is B'wX. In shapes, p is the number of parameters
theta, m that of the columns of all terms that are tried together, k that of one term.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from seqid_cli.discover.select import algebra
from seqid_cli.discover.select.rows import ColumnGroup, Observations, Score, TermFit
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Index

BATCH = 200  # terms that are tried at once


class _Solution(NamedTuple):
    """A Cholesky factor of the scaled M, and the parameters theta (p,)."""

    factor: algebra.Factor
    theta: Array


@dataclass(frozen=True)
class _ChannelColumns:
    """The base's columns at one channel.

    Attributes
    ----------
    index : (p_c,) index array
        The parameters that the channel knows.
    groups : list of (M_c, .) arrays
        Their columns, group by group.
    """

    index: Index
    groups: list[Array]


class LinearModel:
    """Groups of columns, fitted to rows.

    Parameters
    ----------
    rows : Observations
        What is to be explained.
    parts : sequence of ColumnGroup
        What explains it.
    weight : sequence of (M_c,) arrays
        By channel, the precision w of each row [1 / (N m)^2].

    Attributes
    ----------
    where : list of slice
        The place of each group in theta.
    size : int
        Number p of parameters.
    """

    def __init__(
        self,
        rows: Observations,
        parts: Sequence[ColumnGroup],
        weight: Sequence[Array],
    ) -> None:
        self.rows = rows
        self.parts = tuple(parts)
        self.weight = tuple(weight)
        self.where = _slices(part.size for part in self.parts)
        self.size = sum(part.size for part in self.parts)
        self._columns = [self._of_channel(channel) for channel in range(len(rows.y))]
        # of the model's own groups, by their identity
        self._rescored: dict[int, tuple[TermFit, Score]] = {}

    # ---- columns and priors

    @cached_property
    def _root(self) -> list[Array]:
        """Square roots (M_c,) of the weights, by channel."""
        return [np.sqrt(w) for w in self.weight]

    @cached_property
    def _scaled_y(self) -> list[Array]:
        """Rows (M_c,) of unit noise, by channel."""
        return [y * root for y, root in zip(self.rows.y, self._root, strict=True)]

    def without(self, *removed: ColumnGroup) -> LinearModel:
        """Return the model without some of its groups.

        The products of all rows are taken on, so that it costs next to nothing.
        """
        removed_ids = {id(group) for group in removed}
        staying = [
            number
            for number, part in enumerate(self.parts)
            if id(part) not in removed_ids
        ]
        parameters = np.arange(self.size)
        index = np.concatenate([parameters[self.where[number]] for number in staying])
        A, b = self.sums
        smaller = LinearModel(
            self.rows, [self.parts[number] for number in staying], self.weight
        )
        smaller.sums = A[np.ix_(index, index)], b[index]
        return smaller

    def _of_channel(self, channel: int) -> _ChannelColumns:
        index = [np.zeros(0, dtype=np.intp)]
        groups = []
        for part, where in zip(self.parts, self.where, strict=True):
            if channel in part.columns:
                of_part = np.arange(where.start, where.stop)
                index.append(of_part[part.at(channel)])
                groups.append(part.columns[channel])
        return _ChannelColumns(index=np.concatenate(index), groups=groups)

    def _held_precision(self, *, file: bool = True) -> Array:
        """Return the precision (p, p) of what is `held`, with or without the file's."""
        P = np.zeros((self.size, self.size))
        for part, where in zip(self.parts, self.where, strict=True):
            precision = part.precision
            if not file and part.precision_without_file is not None:
                precision = part.precision_without_file
            P[where, where] = precision
        return P

    def in_file(self, part: ColumnGroup) -> Array:
        """Return the parameters R (p, k) that the file has per unit of coefficients."""
        R = np.zeros((self.size, part.size))
        for number, of_group in part.absorbed_by_file.items():
            first = self.where[number].start
            R[first : first + len(of_group), : of_group.shape[1]] = of_group
        return R

    @cached_property
    def lift(self) -> Array:
        """Matrix (p, p) that adds to the parameters what the file has absorbed."""
        U = np.eye(self.size)
        for part, where in zip(self.parts, self.where, strict=True):
            if part.absorbed_by_file:
                U[:, where] += self.in_file(part)
        return U

    @property
    def held(self) -> Array:
        """Parameters (p,) that are held to the file: with what it has absorbed."""
        return np.asarray(self.lift @ self.theta)

    def _coupled(self, held_precision: Array) -> Array:
        """Return the precision (p, p) of the parameters from that of what is held."""
        if not any(part.absorbed_by_file for part in self.parts):
            return held_precision
        return np.asarray(self.lift.T @ held_precision @ self.lift)

    @cached_property
    def prior(self) -> Array:
        """Precision P (p, p) of all parameters beforehand."""
        return self._coupled(self._held_precision())

    # ---- the fit

    def _sums_of(self, rows: Sequence[slice]) -> tuple[Array, Array]:
        """Return A (p, p) and b (p,) of some rows of every channel."""
        A = np.zeros((self.size, self.size))
        b = np.zeros(self.size)
        for columns, root, y, at in zip(
            self._columns, self._root, self._scaled_y, rows, strict=True
        ):
            index = columns.index
            B = _weighted(root[at], [group[at] for group in columns.groups])
            A[np.ix_(index, index)] += B.T @ B
            b[index] += B.T @ y[at]
        return A, b

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """Products A (p, p) and b (p,) of all rows."""
        return self._sums_of([slice(None)] * len(self._columns))

    @cached_property
    def _scale(self) -> Array:
        return algebra.scale_of(np.diag(self.prior) + np.diag(self.sums[0]))

    def _fit(self, A: Array, b: Array) -> _Solution:
        factor = algebra.factored((A + self.prior) * np.outer(self._scale, self._scale))
        return _Solution(factor=factor, theta=self._solved(factor, b))

    def _solved(self, factor: algebra.Factor, right: Array) -> Array:
        """Return M^-1 right, for a vector (p,) or columns (p, k)."""
        scale = self._scale[:, None] if right.ndim == 2 else self._scale
        return np.asarray(cho_solve(factor, right * scale, check_finite=False) * scale)

    def _halved(self, factor: algebra.Factor, right: Array) -> Array:
        """Return R^-T right (p, k) of a factor R: its square is right' M^-1 right."""
        scaled = right * self._scale[:, None]
        return np.asarray(
            solve_triangular(factor[0], scaled, trans="T", check_finite=False)
        )

    @cached_property
    def _all_rows(self) -> _Solution:
        return self._fit(*self.sums)

    @cached_property
    def _without_block(self) -> list[_Solution]:
        """Solution without each block."""
        A, b = self.sums
        solutions = []
        for block_rows in zip(*self.rows.block_slices, strict=True):
            A_block, b_block = self._sums_of(block_rows)
            solutions.append(self._fit(A - A_block, b - b_block))
        return solutions

    @cached_property
    def _without_file(self) -> _Solution:
        """Solution without what the parameter file says."""
        A, b = self.sums
        # `_fit` adds the prior with the file, which is taken off here.
        prior_without_file = self._coupled(self._held_precision(file=False))
        return self._fit(A + prior_without_file - self.prior, b)

    @property
    def theta(self) -> Array:
        """Parameters (p,) given all rows."""
        return self._all_rows.theta

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, p) of `theta`."""
        return self._solved(self._all_rows.factor, np.eye(self.size))

    def _place_of(self, part: ColumnGroup) -> slice:
        return next(
            where
            for group, where in zip(self.parts, self.where, strict=True)
            if group is part
        )

    def jackknife(self, at: slice) -> Array:
        """Return the covariance (k, k) of some of `theta` by leaving out each block."""
        values = np.array([solution.theta[at] for solution in self._without_block])
        deviation = values - values.mean(axis=0)
        return np.asarray((1.0 - 1.0 / len(values)) * deviation.T @ deviation)

    @cached_property
    def evidence(self) -> float:
        """Log density of the rows, their weights' part aside."""
        factor, theta = self._all_rows
        scaled = self._held_precision() * np.outer(self._scale, self._scale)
        prior_log_det = sum(
            algebra.half_log_det(algebra.factored(scaled[at, at])) for at in self.where
        )
        square = sum(float(y @ y) for y in self._scaled_y)
        explained = float(self.sums[1] @ theta)
        return 0.5 * (explained - square) - algebra.half_log_det(factor) + prior_log_det

    # ---- what the model leaves

    def residual(self) -> list[Array]:
        """Return what is left (M_c,) N m of every channel."""
        return [
            self._left(channel, slice(None), self.theta)
            for channel in range(len(self._scaled_y))
        ]

    @cached_property
    def left_out(self) -> list[Array]:
        """What is left (M_c,) N m of every block by a fit to all others, by channel."""
        thetas = [solution.theta for solution in self._without_block]
        by_channel = []
        for channel, block_rows in enumerate(self.rows.block_slices):
            parts = [
                self._left(channel, rows, theta)
                for rows, theta in zip(block_rows, thetas, strict=True)
            ]
            by_channel.append(np.concatenate(parts))
        return by_channel

    def torque_beside_file(self, part: ColumnGroup, channel: int) -> Array:
        """Return the torque (M_c,) N m of a group less what the file has absorbed."""
        where = self._place_of(part)
        theta = -self.in_file(part) @ self.theta[where]
        theta[where] = self.theta[where]
        return self.rows.y[channel] - self._left(channel, slice(None), theta)

    def _left(self, channel: int, rows: slice, theta: Array) -> Array:
        columns = self._columns[channel]
        residual = self.rows.y[channel][rows].copy()
        first = 0
        for group in columns.groups:
            stop = first + group.shape[1]
            residual -= group[rows] @ theta[columns.index[first:stop]]
            first = stop
        return residual

    # ---- groups that the model has

    def again(self, part: ColumnGroup) -> tuple[TermFit, Score]:
        """Return fit and score of a group of the model, as if it were to be added.

        The log Bayes factor is the density of its coefficients at zero, beforehand over
        given the rows (Savage's ratio: J. M. Dickey, Annals of Mathematical Statistics
        42, 1971).
        """
        if id(part) not in self._rescored:
            self._rescored[id(part)] = self._fit_and_score_of(part)
        return self._rescored[id(part)]

    def _fit_and_score_of(self, part: ColumnGroup) -> tuple[TermFit, Score]:
        at = self._place_of(part)
        unit = np.eye(self.size)[:, at]

        def estimate(solution: _Solution) -> tuple[Array, Array]:
            """Return coefficients (k,) and their covariance (k, k)."""
            return solution.theta[at], self._solved(solution.factor, unit)[at]

        def log_bayes_factor(solution: _Solution) -> float:
            a, S = estimate(solution)
            return algebra.taken_back(a, S, part.precision)

        log_factor = log_bayes_factor(self._all_rows)
        log_factor_without_file = log_bayes_factor(self._without_file)
        without_block = np.array([log_bayes_factor(x) for x in self._without_block])

        a, S = estimate(self._all_rows)
        unexplained = np.trace(np.linalg.inv(S) - part.precision)
        square = max(float(np.trace(self.sums[0][at, at])), 1e-300)
        fit = TermFit(
            log_bayes_factor=log_factor,
            coefficients=a,
            covariance=S,
            visible_share=max(float(unexplained / square), 0.0),
        )
        score = Score(
            block_gains=log_factor - without_block,
            rows=self._independent_rows(part),
            file_gain=log_factor - log_factor_without_file,
        )
        return fit, score

    def _independent_rows(self, part: ColumnGroup) -> Array:
        """Return the number (blocks,) of independent rows at a group's channels."""
        return np.asarray(self.rows.independent[sorted(part.columns)].sum(axis=0))

    def varied(self, part: ColumnGroup, *, spread: float = 0.3) -> float:
        """Return the log evidence that a group has another size in every block.

        The sizes differ by a share of `spread` (standard deviation).
        """
        at = self._place_of(part)
        n_blocks = self.rows.blocks
        C = np.zeros((self.size, n_blocks))
        D = np.zeros(n_blocks)
        d = np.zeros(n_blocks)
        for channel in part.columns:
            columns = self._columns[channel]
            torque = part.torque(channel, self.theta[at])
            weighted = torque * self.weight[channel]
            residual = self._left(channel, slice(None), self.theta)
            for block, rows in enumerate(self.rows.block_slices[channel]):
                C[columns.index, block] += np.concatenate(
                    [group[rows].T @ weighted[rows] for group in columns.groups]
                )
                D[block] += torque[rows] @ weighted[rows]
                d[block] += residual[rows] @ weighted[rows]

        Z = self._halved(self._all_rows.factor, C)
        factors = algebra.bayes_factor(
            np.diag(D) - Z.T @ Z, d, np.eye(n_blocks) / spread**2
        )
        return float(factors.log_factor)

    # ---- terms that the model does not have

    def fits(self, terms: Sequence[ColumnGroup]) -> list[TermFit]:
        """Fit each term by itself beside the model."""
        every_row = [(slice(0, len(y)),) for y in self._scaled_y]
        fits: list[TermFit] = []
        for first in range(0, len(terms), BATCH):
            crossed = self._crossed(terms[first : first + BATCH], every_row)
            with_file = self._coupled_products(crossed)
            fits += self._fits_beside(self._all_rows, crossed, with_file)
        return fits

    def scores(self, terms: Sequence[ColumnGroup]) -> list[Score]:
        """Score each term by itself on every block, all fitted to the other blocks."""
        if not terms:
            return []

        crossed = self._crossed(terms, self.rows.block_slices)
        with_file = self._coupled_products(crossed)
        without_file = self._coupled_products(crossed, file=False)
        fits = self._fits_beside(self._all_rows, crossed, with_file)
        fits_without_file = self._fits_beside(self._without_file, crossed, without_file)

        # What the base, fitted without a block, explains of columns and of rows.
        explained = [np.empty_like(D) for D in crossed.D]
        residual_product = np.empty_like(crossed.d)
        d = crossed.total.d
        for block, (factor, theta) in enumerate(self._without_block):
            C = with_file.C - crossed.C[block]
            Z = self._halved(factor, C)
            residual_product[block] = d - crossed.d[block] - C.T @ theta
            for of_term, at in zip(explained, crossed.where, strict=True):
                of_term[block] = Z[:, at].T @ Z[:, at]

        scores = []
        for number, term in enumerate(crossed.terms):
            at = crossed.where[number]
            without_block = algebra.bayes_factor(
                with_file.D[number] - crossed.D[number] - explained[number],
                residual_product[:, at],
                term.precision,
            )
            log_factor = fits[number].log_bayes_factor
            scores.append(
                Score(
                    block_gains=log_factor - without_block.log_factor,
                    rows=self._independent_rows(term),
                    file_gain=log_factor - fits_without_file[number].log_bayes_factor,
                )
            )
        return scores

    def _coupled_products(self, crossed: _Crossed, *, file: bool = True) -> _Products:
        """Return the products of all blocks and of what is held to the file.

        Without `file` what the parameter file says is left out.
        """
        C = crossed.total.C
        D = crossed.total.D
        if not any(term.absorbed_by_file for term in crossed.terms):
            return _Products(C=C, D=D)

        R = np.hstack([self.in_file(term) for term in crossed.terms])
        PR = self._held_precision(file=file) @ R
        D_coupled = [
            of_term + R[:, at].T @ PR[:, at]
            for of_term, at in zip(D, crossed.where, strict=True)
        ]
        return _Products(C=C + self.lift.T @ PR, D=D_coupled)

    def _fits_beside(
        self, solution: _Solution, crossed: _Crossed, products: _Products
    ) -> list[TermFit]:
        """Return what each term by itself does to a solved model."""
        Z = self._halved(solution.factor, products.C)
        residual_product = crossed.total.d - products.C.T @ solution.theta
        fits = []
        for term, at, D, D_rows in zip(
            crossed.terms, crossed.where, products.D, crossed.total.D, strict=True
        ):
            S = D - Z[:, at].T @ Z[:, at]
            factors = algebra.bayes_factor(S, residual_product[at], term.precision)
            visible = float(np.trace(S) / max(float(np.trace(D_rows)), 1e-300))
            fits.append(
                TermFit(
                    log_bayes_factor=float(factors.log_factor),
                    coefficients=factors.coefficients,
                    covariance=factors.covariance,
                    visible_share=max(visible, 0.0),
                )
            )
        return fits

    def _crossed(
        self, terms: Sequence[ColumnGroup], rows: Sequence[Sequence[slice]]
    ) -> _Crossed:
        """Return products of terms with all else, over slices of each channel's rows.

        Terms with the same columns share their products: these take most of the time.
        """
        where = _slices(term.size for term in terms)
        n_slices = len(rows[0])
        n_columns = where[-1].stop
        C = np.zeros((n_slices, self.size, n_columns))
        d = np.zeros((n_slices, n_columns))
        D = [np.zeros((n_slices, term.size, term.size)) for term in terms]

        # The first of the terms with the same columns, for every term.
        first_of = dict[tuple[int, ...], int]()
        keys = [(term.size, *map(id, term.columns.values())) for term in terms]
        original = [first_of.setdefault(key, i) for i, key in enumerate(keys)]

        for channel, base in enumerate(self._columns):
            present = [i for i in first_of.values() if channel in terms[i].columns]
            if not present:
                continue
            places = []
            for i in present:
                of_term = np.arange(where[i].start, where[i].stop)
                places.append(of_term[terms[i].at(channel)])
            columns = np.concatenate(places)
            edges = np.cumsum([len(place) for place in places])[:-1]
            block = np.ix_(base.index, columns)

            for k, in_slice in enumerate(rows[channel]):
                for tile in tiles(in_slice.stop, in_slice.start):
                    X_each = [terms[i].columns[channel][tile] for i in present]
                    wX = _weighted(self.weight[channel][tile], X_each)
                    if base.groups:  # none above a cut-off
                        C[k][block] += np.vstack([B[tile].T @ wX for B in base.groups])
                    d[k, columns] += self.rows.y[channel][tile] @ wX
                    wX_each = np.split(wX, edges, axis=1)
                    for i, X, wX_of_term in zip(present, X_each, wX_each, strict=True):
                        at = terms[i].at(channel)
                        D[i][k, at, at] += X.T @ wX_of_term

        for i, first in enumerate(original):
            if i != first:
                C[:, :, where[i]] = C[:, :, where[first]]
                d[:, where[i]] = d[:, where[first]]
                D[i] = D[first]
        return _Crossed(terms=terms, where=where, C=C, d=d, D=D)


class _Products(NamedTuple):
    """Products C (p, m) of terms with the base, and D (k, k) of each with itself."""

    C: Array
    D: list[Array]


@dataclass(frozen=True, kw_only=True)
class _Crossed:
    """Products of terms with the model's columns, the rows and themselves, by block."""

    terms: Sequence[ColumnGroup]
    where: list[slice]
    C: Array  # (blocks, p, m)
    d: Array  # (blocks, m)
    D: list[Array]  # (blocks, k, k) of each term

    @cached_property
    def total(self) -> _Total:
        """The products of all blocks."""
        return _Total(
            C=self.C.sum(axis=0),
            d=self.d.sum(axis=0),
            D=[of_term.sum(axis=0) for of_term in self.D],
        )


class _Total(NamedTuple):
    """Products C (p, m), d (m,), and D (k, k) of each term, of all blocks."""

    C: Array
    d: Array
    D: list[Array]


def _slices(sizes: Iterable[int]) -> list[slice]:
    """Return places of so many numbers each, one after the other."""
    edges: list[int] = np.cumsum([0, *sizes]).tolist()
    return [slice(start, stop) for start, stop in pairwise(edges)]


def _weighted(weight: Array, columns: Sequence[Array]) -> Array:
    """Return columns (M, k) each, side by side and times a weight (M,)."""
    sizes = [group.shape[1] for group in columns]
    result = np.empty((len(weight), sum(sizes)))
    for group, at in zip(columns, _slices(sizes), strict=True):
        np.multiply(group, weight[:, None], out=result[:, at])
    return result
