"""A Gaussian linear model of all rows, its evidence, and scores on left-out parts.

Rows y of a channel (a joint's torque below the cut-off, or above it) are

    y = B theta + e,   theta ~ N(0, P^-1),   e ~ N(0, 1 / w),

with the precision w of each row. A term with columns X and coefficients a ~ N(0, Q^-1)
raises the log evidence by

    E = d' (Q + D)^-1 d / 2 - log det(I + Q^-1 D) / 2,
    D = X'wX - X'wB M^-1 B'wX,   d = X'w (y - B M^-1 B'wy),   M = P + B'wB,

and the log density that all other parts predict for part b by E - E without b. A part
is a block of time, or all blocks of the same stretch of a motion that comes again. All
of it follows from products part by part: no fit is repeated. What a parameter file says
of the base is a part as well: a base that is free enough takes up a constant effect at
the price of leaving the file, and E - E without the file is what the term saves of it.
Of an effect that was there when the file was identified the file has R a in its base:
theta + R a ~ N(0, P^-1) then, which couples the two.

Slow noise has columns S with coefficients g ~ N(0, V^-1) of each log and channel by
themselves. With many logs these are most of all parameters, and none is of interest. So
they are eliminated from the products of their log: with G = V + S'wS

    A - B'wS G^-1 S'wB,   b - B'wS G^-1 S'wy,   and C, d, D likewise

are products of the same kind, and what follows has the size of what all logs share.
Blocks that are left out take their share from G as well: what they are worth is the
difference of their logs' products with and without them.

In the code A is B'wB, b is B'wy and C is B'wX. In shapes, p is the number of parameters
theta, m that of the columns of all terms that are tried together, k that of one term, s
that of a log's own columns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from seqid_cli.discover.select import algebra
from seqid_cli.discover.select.arrow import Arrow, ArrowFactor, Layout, Place
from seqid_cli.discover.select.rows import (
    ColumnGroup,
    LogColumns,
    Observations,
    Recurring,
    Score,
    TermFit,
)
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Index

BATCH = 200  # terms that are tried at once


class _Solution(NamedTuple):
    """A root of the scaled M, and the parameters theta (p,)."""

    factor: ArrowFactor
    theta: Array


class _Absorbing(NamedTuple):
    """What the file has absorbed of the model's own groups.

    Attributes
    ----------
    places : (K,) index array
        The parameters of the groups of which it has absorbed anything.
    in_file : (p, K) array
        The parameters R that the file has per unit of these.
    """

    places: Index
    in_file: Array


@dataclass(frozen=True)
class _ChannelColumns:
    """The base's columns at one channel.

    Attributes
    ----------
    index : (p_c,) index array
        The parameters that the channel knows.
    groups : list of (M_c, .) arrays
        Their columns, group by group.
    of_log : LogColumns, optional
        Columns that each log has for itself.
    """

    index: Index
    groups: list[Array]
    of_log: LogColumns | None = None

    @property
    def all_groups(self) -> list[Array]:
        """The columns, then those that each log has for itself."""
        if self.of_log is None:
            return self.groups
        return [*self.groups, self.of_log.columns]


@dataclass(frozen=True)
class _Eliminated:
    """A log's own columns at one channel, with root R of G = R R'.

    Attributes
    ----------
    root : (s, s) array
        R, lower triangular.
    base : (s, p_c) array
        R^-1 S'wB.
    y : (s,) array
        R^-1 S'wy.
    """

    root: Array
    base: Array
    y: Array

    def halved(self, products: Array) -> Array:
        """Return R^-1 S'wX of products S'wX (s, m)."""
        return np.asarray(
            solve_triangular(self.root, products, lower=True, check_finite=False)
        )

    def coefficients(self, theta: Array) -> Array:
        """Return the coefficients (s,) beside parameters (p_c,) of the channel."""
        return np.asarray(
            solve_triangular(
                self.root,
                self.y - self.base @ theta,
                lower=True,
                trans="T",
                check_finite=False,
            )
        )


@dataclass(frozen=True)
class _OwnColumns:
    """The own columns of all L logs at one channel.

    Attributes
    ----------
    products : (L, s, p_c + s + 1) array
        S'w [B, S, y], log by log.
    root : (L, s, s) array
        Roots R of G, lower triangular.
    base : (L, s, p_c) array
        R^-1 S'wB.
    y : (L, s) array
        R^-1 S'wy.
    """

    products: Array
    root: Array
    base: Array
    y: Array

    @classmethod
    def of(cls, products: Array, precision: Array) -> _OwnColumns:
        """Factor the products (L, s, p_c + s + 1); `precision` (s, s) is V."""
        s = len(precision)
        p = products.shape[-1] - s - 1
        root = np.linalg.cholesky(products[..., p : p + s] + precision)
        others = np.concatenate([products[..., :p], products[..., -1:]], axis=-1)
        halved = np.linalg.solve(root, others)
        return cls(
            products=products,
            root=np.asarray(root, dtype=np.float64),
            base=np.asarray(halved[..., :p], dtype=np.float64),
            y=np.asarray(halved[..., -1], dtype=np.float64),
        )

    def of_log(self, log: int) -> _Eliminated:
        """Return those of one log."""
        return _Eliminated(root=self.root[log], base=self.base[log], y=self.y[log])

    def coefficients(self, theta: Array) -> Array:
        """Return the coefficients (L, s) beside parameters (p_c,) of the channel."""
        left = self.y - self.base @ theta
        upper = np.swapaxes(self.root, -1, -2)
        return np.asarray(np.linalg.solve(upper, left[..., None])[..., 0])


class _WithoutPart(NamedTuple):
    """The fit to all other parts, and own columns by channel and log of the part."""

    solution: _Solution
    eliminated: dict[tuple[int, int], _Eliminated]


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
    of_logs : sequence of LogColumns
        Columns that each log has for itself; a channel has one of them at most.
    recurring : sequence of Recurring or None
        By channel, noise that rows of one moment of a motion share; none if left out.

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
        of_logs: Sequence[LogColumns] = (),
        *,
        recurring: Sequence[Recurring | None] = (),
    ) -> None:
        self.rows = rows
        self.parts = tuple(parts)
        self.weight = tuple(weight)
        self.of_logs = tuple(of_logs)
        self.recurring = tuple(recurring) or (None,) * len(rows.y)
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
        return [
            self._of_unit_noise(channel, [y[:, None]])[:, 0]
            for channel, y in enumerate(self.rows.y)
        ]

    def _of_unit_noise(self, channel: int, columns: Sequence[Array]) -> Array:
        """Return columns (M_c, k) each of a channel, side by side, of unit noise."""
        scaled = _weighted(self._root[channel], columns)
        recurring = self.recurring[channel]
        return scaled if recurring is None else recurring.taken_off(scaled)

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
            self.rows,
            [self.parts[number] for number in staying],
            self.weight,
            self.of_logs,
            recurring=self.recurring,
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
        of_log = next((own for own in self.of_logs if own.channel == channel), None)
        return _ChannelColumns(
            index=np.concatenate(index), groups=groups, of_log=of_log
        )

    def _held_precisions(self, *, file: bool = True) -> list[Array]:
        """Return the precision (k, k) of each group, with or without the file's."""
        return [
            part.precision
            if file or part.precision_without_file is None
            else part.precision_without_file
            for part in self.parts
        ]

    def _held_times(self, right: Array, *, file: bool = True) -> Array:
        """Return the precision of what is `held`, times columns (p, m)."""
        result = np.empty_like(right)
        for where, precision in zip(
            self.where, self._held_precisions(file=file), strict=True
        ):
            result[where] = precision @ right[where]
        return result

    def in_file(self, part: ColumnGroup) -> Array:
        """Return the parameters R (p, k) that the file has per unit of coefficients."""
        R = np.zeros((self.size, part.size))
        for number, of_group in part.absorbed_by_file.items():
            first = self.where[number].start
            R[first : first + len(of_group), : of_group.shape[1]] = of_group
        return R

    @cached_property
    def _absorbing(self) -> _Absorbing:
        places = [np.zeros(0, dtype=np.intp)]
        in_file = [np.zeros((self.size, 0))]
        for part, where in zip(self.parts, self.where, strict=True):
            if part.absorbed_by_file:
                places.append(np.arange(where.start, where.stop))
                in_file.append(self.in_file(part))
        return _Absorbing(places=np.concatenate(places), in_file=np.hstack(in_file))

    @property
    def held(self) -> Array:
        """Parameters (p,) that are held to the file: with what it has absorbed."""
        places, in_file = self._absorbing
        return np.asarray(self.theta + in_file @ self.theta[places])

    @property
    def held_covariance(self) -> Array:
        """Covariance (p, p) of `held`."""
        places, in_file = self._absorbing
        one_side = self.covariance + in_file @ self.covariance[places]
        return np.asarray(one_side + one_side[:, places] @ in_file.T)

    def _felt(self, right: Array) -> Array:
        """Return what the parameters feel of columns (p, m) that what is held feels."""
        places, in_file = self._absorbing
        result = right.copy()
        result[places] += in_file.T @ right
        return result

    def _prior(self, *, file: bool = True) -> Array:
        """Return the precision (p, p) of all parameters, with or without the file's."""
        P = np.zeros((self.size, self.size))
        for where, precision in zip(
            self.where, self._held_precisions(file=file), strict=True
        ):
            P[where, where] = precision
        places, in_file = self._absorbing
        if len(places):
            tied = self._held_times(in_file, file=file)
            P[:, places] += tied
            P[places] += tied.T
            P[np.ix_(places, places)] += in_file.T @ tied
        return P

    @cached_property
    def prior(self) -> Array:
        """Precision P (p, p) of all parameters beforehand."""
        return self._prior()

    # ---- the fit

    def _scaled(
        self, channel: int, slices: Sequence[slice]
    ) -> Iterator[tuple[Array, Array]]:
        """Yield rows of unit noise of a channel's columns, and the logs' own."""
        columns = self._columns[channel]
        p = len(columns.index)
        if self.recurring[channel] is None:
            root = self._root[channel]
            for at in slices:
                scaled = _weighted(root[at], [X[at] for X in columns.all_groups])
                yield scaled[:, :p], scaled[:, p:]
            return

        # Rows of one moment stand far from each other.
        scaled = self._of_unit_noise(channel, columns.all_groups)
        for at in slices:
            yield scaled[at, :p], scaled[at, p:]

    @staticmethod
    def _own_products(base: Array, own: Array, y: Array) -> Array:
        """Return S'w [B, S, y] (s, p_c + s + 1) of some rows of unit noise."""
        return np.column_stack([own.T @ base, own.T @ own, own.T @ y])

    @cached_property
    def _sums_and_own(
        self,
    ) -> tuple[list[tuple[Array, Array]], list[_OwnColumns | None]]:
        """Products A, b of every channel, nothing out, and the logs' own columns."""
        sums = []
        own_columns: list[_OwnColumns | None] = []
        for channel, columns in enumerate(self._columns):
            ((base, own),) = self._scaled(channel, [slice(None)])
            y = self._scaled_y[channel]
            sums.append((base.T @ base, base.T @ y))
            if columns.of_log is None:
                own_columns.append(None)
                continue
            products = [
                self._own_products(base[at], own[at], y[at])
                for at in self.rows.log_slices[channel]
            ]
            own_columns.append(
                _OwnColumns.of(np.stack(products), columns.of_log.precision)
            )
        return sums, own_columns

    @property
    def _own(self) -> list[_OwnColumns | None]:
        """The logs' own columns, channel by channel."""
        return self._sums_and_own[1]

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """Products A (p, p) and b (p,) of all rows, the logs' own columns out."""
        A = np.zeros((self.size, self.size))
        b = np.zeros(self.size)
        for columns, of_channel, own in zip(
            self._columns, *self._sums_and_own, strict=True
        ):
            index = columns.index
            A[np.ix_(index, index)] += of_channel[0]
            b[index] += of_channel[1]
            if own is not None:
                base = own.base.reshape(own.y.size, len(index))
                A[np.ix_(index, index)] -= base.T @ base
                b[index] -= base.T @ own.y.ravel()
        return A, b

    @cached_property
    def _scale(self) -> Array:
        return algebra.scale_of(np.diag(self.prior) + np.diag(self.sums[0]))

    @cached_property
    def _layout(self) -> Layout:
        return Layout.of(
            self.where,
            [list(part.columns) for part in self.parts],
            [not part.absorbed_by_file for part in self.parts],
        )

    @cached_property
    def _places(self) -> list[Place]:
        """Where the parameters of each channel stand in the parts of M."""
        return [self._layout.place(columns.index) for columns in self._columns]

    @cached_property
    def _precision(self) -> Arrow:
        """The scaled M of all rows."""
        return self._scaled_precision(self.sums[0] + self.prior)

    def _scaled_precision(self, M: Array) -> Arrow:
        """Return the parts of M (p, p), scaled in place."""
        M *= self._scale[:, None]
        M *= self._scale
        return self._layout.arrow(M)

    def _fit(self, precision: Arrow, b: Array) -> _Solution:
        factor = precision.factored()
        theta = factor.solved((b * self._scale)[:, None])[:, 0] * self._scale
        return _Solution(factor=factor, theta=theta)

    def _halved(self, factor: ArrowFactor, right: Array) -> Array:
        """Return R^-1 right (p, k) of a root R: its square is right' M^-1 right."""
        return factor.halved(right * self._scale[:, None])

    @cached_property
    def _all_rows(self) -> _Solution:
        return self._fit(self._precision, self.sums[1])

    @cached_property
    def _without_part(self) -> list[_WithoutPart]:
        """The fit without each part."""
        return [self._without_blocks(blocks) for blocks in self.rows.blocks_of_part]

    def forget_parts(self) -> None:
        """Let go of the fits without each part, which take most of the room.

        They are worked out again if they are asked for.
        """
        self.__dict__.pop("_without_part", None)

    def _without_blocks(self, blocks: Index) -> _WithoutPart:
        """Return the fit without the rows of some blocks."""
        precision = self._precision.copy()
        b = self.sums[1].copy()
        eliminated: dict[tuple[int, int], _Eliminated] = {}
        for channel, columns in enumerate(self._columns):
            own = self._own[channel]
            # Above a cut-off a base has no columns.
            if not len(columns.index) and own is None:
                continue

            change = np.zeros((len(columns.index), len(columns.index)))
            products_of_log: dict[int, Array] = {}
            slices = [self.rows.block_slices[channel][block] for block in blocks]
            logs = self.rows.log[blocks].tolist()
            for at, log, (base, own_columns) in zip(
                slices, logs, self._scaled(channel, slices), strict=True
            ):
                if at.stop == at.start:
                    continue
                y = self._scaled_y[channel][at]
                change -= base.T @ base
                b[columns.index] -= base.T @ y
                if own is not None:
                    products = self._own_products(base, own_columns, y)
                    products_of_log[log] = products + products_of_log.get(log, 0.0)

            if own is not None and columns.of_log is not None:
                for log, products in products_of_log.items():
                    others = (own.products[log] - products)[None]
                    without = _OwnColumns.of(others, columns.of_log.precision).of_log(0)
                    of_log = own.of_log(log)
                    change += of_log.base.T @ of_log.base
                    change -= without.base.T @ without.base
                    b[columns.index] += of_log.base.T @ of_log.y
                    b[columns.index] -= without.base.T @ without.y
                    eliminated[channel, log] = without
            self._change(precision, channel, change)
        return _WithoutPart(self._fit(precision, b), eliminated)

    def _change(self, precision: Arrow, channel: int, change: Array) -> None:
        """Change the scaled M by products (p_c, p_c) of one channel."""
        scale = self._scale[self._columns[channel].index]
        change *= scale[:, None]
        change *= scale
        precision.add(self._places[channel], change)

    @cached_property
    def _without_file(self) -> _Solution:
        """Solution without what the parameter file says."""
        A, b = self.sums
        return self._fit(self._scaled_precision(A + self._prior(file=False)), b)

    @property
    def theta(self) -> Array:
        """Parameters (p,) given all rows."""
        return self._all_rows.theta

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, p) of `theta`."""
        unit = np.diag(self._scale)
        return self._all_rows.factor.solved(unit) * self._scale[:, None]

    def _place_of(self, part: ColumnGroup) -> slice:
        return next(
            where
            for group, where in zip(self.parts, self.where, strict=True)
            if group is part
        )

    def jackknife(self, at: slice) -> Array:
        """Return the covariance (k, k) of some of `theta` by leaving out each part."""
        values = np.array([fit.solution.theta[at] for fit in self._without_part])
        deviation = values - values.mean(axis=0)
        return np.asarray((1.0 - 1.0 / len(values)) * deviation.T @ deviation)

    @cached_property
    def evidence(self) -> float:
        """Log density of the rows, their weights' part aside."""
        factor, theta = self._all_rows
        prior_log_det = 0.0
        for at, precision in zip(self.where, self._held_precisions(), strict=True):
            scale = self._scale[at]
            scaled = precision * np.outer(scale, scale)
            prior_log_det += algebra.half_log_det(algebra.factored(scaled))
        square = sum(float(y @ y) for y in self._scaled_y)
        explained = float(self.sums[1] @ theta) + self._explained_by_logs
        worth = 0.5 * (explained - square) - self._half_log_det_of_logs
        return worth - factor.half_log_det + prior_log_det

    @property
    def _explained_by_logs(self) -> float:
        """Square of the rows that the logs' own columns explain by themselves."""
        return sum(float(np.sum(own.y**2)) for own in self._own if own is not None)

    @property
    def _half_log_det_of_logs(self) -> float:
        """Half the logarithm of the determinants of G V^-1, all logs together."""
        total = 0.0
        for columns, own in zip(self._columns, self._own, strict=True):
            if own is None or columns.of_log is None:
                continue
            diagonal = np.diagonal(own.root, axis1=-2, axis2=-1)
            prior = 0.5 * float(np.log(np.diag(columns.of_log.precision)).sum())
            total += float(np.log(diagonal).sum()) - len(own.root) * prior
        return total

    # ---- what the model leaves

    def residual(self) -> list[Array]:
        """Return what is left (M_c,) N m of every channel."""
        by_channel = []
        for channel, columns in enumerate(self._columns):
            left = self._left(channel, slice(None), self.theta)
            own = self._own[channel]
            if own is not None and columns.of_log is not None:
                coefficients = own.coefficients(self.theta[columns.index])
                lengths = [at.stop - at.start for at in self.rows.log_slices[channel]]
                of_row = np.repeat(coefficients, lengths, axis=0)
                left -= np.sum(columns.of_log.columns * of_row, axis=1)
            by_channel.append(left)
        return by_channel

    @cached_property
    def left_out(self) -> list[Array]:
        """What is left (M_c,) N m of every part by a fit to all others, by channel."""
        by_channel = []
        for channel, slices in enumerate(self.rows.block_slices):
            left = np.empty_like(self.rows.y[channel])
            for block, at in enumerate(slices):
                fit = self._without_part[self.rows.part[block]]
                own = fit.eliminated.get((channel, int(self.rows.log[block])))
                left[at] = self._left(channel, at, fit.solution.theta, own)
            by_channel.append(left)
        return by_channel

    def left_out_of(self, group_of_log: Index) -> list[Array]:
        """Return what is left (M_c,) N m of groups of logs by a fit to all others.

        A log's own slow noise is not known from others: it is no part of the
        prediction.

        Parameters
        ----------
        group_of_log : (L,) index array
            The group of each log.
        """
        left = [np.zeros(len(y)) for y in self.rows.y]
        for group in np.unique(group_of_log):
            logs = np.flatnonzero(group_of_log == group)
            theta = self._without_logs(logs).theta
            for channel, slices in enumerate(self.rows.log_slices):
                for log in logs:
                    at = slices[log]
                    left[channel][at] = self._left(channel, at, theta)
        return left

    def _without_logs(self, logs: Index) -> _Solution:
        """Return the fit without the rows of some logs."""
        precision = self._precision.copy()
        b = self.sums[1].copy()
        for channel, columns in enumerate(self._columns):
            own = self._own[channel]
            change = np.zeros((len(columns.index), len(columns.index)))
            slices = [self.rows.log_slices[channel][log] for log in logs]
            for at, log, (base, _) in zip(
                slices, logs, self._scaled(channel, slices), strict=True
            ):
                change -= base.T @ base
                b[columns.index] -= base.T @ self._scaled_y[channel][at]
                if own is not None:
                    change += own.base[log].T @ own.base[log]
                    b[columns.index] += own.base[log].T @ own.y[log]
            self._change(precision, channel, change)
        return self._fit(precision, b)

    def torque_beside_file(self, part: ColumnGroup, channel: int) -> Array:
        """Return the torque (M_c,) N m of a group less what the file has absorbed."""
        where = self._place_of(part)
        theta = -self.in_file(part) @ self.theta[where]
        theta[where] = self.theta[where]
        return self.rows.y[channel] - self._left(channel, slice(None), theta)

    def _left(
        self,
        channel: int,
        rows: slice,
        theta: Array,
        eliminated: _Eliminated | None = None,
    ) -> Array:
        """Return what parameters (p,), and a log's own columns, leave of its rows."""
        columns = self._columns[channel]
        residual = self.rows.y[channel][rows].copy()
        first = 0
        for group in columns.groups:
            stop = first + group.shape[1]
            residual -= group[rows] @ theta[columns.index[first:stop]]
            first = stop
        if columns.of_log is not None and eliminated is not None:
            own = eliminated.coefficients(theta[columns.index])
            residual -= columns.of_log.columns[rows] @ own
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
        unit = np.zeros((self.size, part.size))
        unit[at] = np.eye(part.size)

        def estimate(solution: _Solution) -> tuple[Array, Array]:
            """Return coefficients (k,) and their covariance (k, k)."""
            half = self._halved(solution.factor, unit)
            return solution.theta[at], half.T @ half

        def log_bayes_factor(solution: _Solution) -> float:
            a, S = estimate(solution)
            return algebra.taken_back(a, S, part.precision)

        log_factor = log_bayes_factor(self._all_rows)
        log_factor_without_file = log_bayes_factor(self._without_file)
        without_part = np.array(
            [log_bayes_factor(fit.solution) for fit in self._without_part]
        )

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
            part_gains=log_factor - without_part,
            rows=self._independent_rows(part),
            file_gain=log_factor - log_factor_without_file,
        )
        return fit, score

    def _independent_rows(self, part: ColumnGroup) -> Array:
        """Return the number (parts,) of independent rows at a group's channels."""
        return np.asarray(self.rows.independent[sorted(part.columns)].sum(axis=0))

    def varied(self, part: ColumnGroup, *, spread: float = 0.3) -> float:
        """Return the log evidence that a group has another size in every block.

        The sizes differ by a share of `spread` (standard deviation).
        """
        at = self._place_of(part)
        n_blocks = self.rows.blocks
        C = np.zeros((self.size, n_blocks))
        D = np.zeros((n_blocks, n_blocks))
        d = np.zeros(n_blocks)
        all_residuals = self.residual()
        for channel in part.columns:
            columns = self._columns[channel]
            p = len(columns.index)
            torque = part.torque(channel, self.theta[at])
            weighted = torque * self.weight[channel]
            residual = all_residuals[channel]
            sizes = [group.shape[1] for group in columns.all_groups]
            products = np.zeros((sum(sizes), n_blocks))
            for block, rows in enumerate(self.rows.block_slices[channel]):
                products[:, block] = np.concatenate(
                    [group[rows].T @ weighted[rows] for group in columns.all_groups]
                )
                D[block, block] += torque[rows] @ weighted[rows]
                d[block] += residual[rows] @ weighted[rows]

            C[columns.index] += products[:p]
            own_columns = self._own[channel]
            if own_columns is None:
                continue
            for log in range(len(own_columns.root)):
                own = own_columns.of_log(log)
                blocks = np.flatnonzero(self.rows.log == log)
                halved = own.halved(products[p:, blocks])
                C[np.ix_(columns.index, blocks)] -= own.base.T @ halved
                D[np.ix_(blocks, blocks)] -= halved.T @ halved

        Z = self._halved(self._all_rows.factor, C)
        factors = algebra.bayes_factor(D - Z.T @ Z, d, np.eye(n_blocks) / spread**2)
        return float(factors.log_factor)

    # ---- terms that the model does not have

    def fits(self, terms: Sequence[ColumnGroup]) -> list[TermFit]:
        """Fit each term by itself beside the model."""
        fits: list[TermFit] = []
        for first in range(0, len(terms), BATCH):
            crossed = self._crossed(terms[first : first + BATCH], by_part=False)
            with_file = self._coupled_products(crossed)
            fits += self._fits_beside(self._all_rows, crossed, with_file)
        return fits

    def scores(self, terms: Sequence[ColumnGroup]) -> list[Score]:
        """Score each term by itself on every part, all fitted to the other parts."""
        if not terms:
            return []

        crossed = self._crossed(terms, by_part=True)
        with_file = self._coupled_products(crossed)
        without_file = self._coupled_products(crossed, file=False)
        fits = self._fits_beside(self._all_rows, crossed, with_file)
        fits_without_file = self._fits_beside(self._without_file, crossed, without_file)

        # What the base, fitted without a part, explains of columns and of rows.
        explained = [np.empty_like(D) for D in crossed.D]
        residual_product = np.empty_like(crossed.d)
        d = crossed.total.d
        for part, fit in enumerate(self._without_part):
            factor, theta = fit.solution
            C = with_file.C - crossed.C[part]
            Z = self._halved(factor, C)
            residual_product[part] = d - crossed.d[part] - C.T @ theta
            for of_term, at in zip(explained, crossed.where, strict=True):
                of_term[part] = Z[:, at].T @ Z[:, at]

        scores = []
        for number, term in enumerate(crossed.terms):
            at = crossed.where[number]
            without_part = algebra.bayes_factor(
                with_file.D[number] - crossed.D[number] - explained[number],
                residual_product[:, at],
                term.precision,
            )
            log_factor = fits[number].log_bayes_factor
            scores.append(
                Score(
                    part_gains=log_factor - without_part.log_factor,
                    rows=self._independent_rows(term),
                    file_gain=log_factor - fits_without_file[number].log_bayes_factor,
                )
            )
        return scores

    def _coupled_products(self, crossed: _Crossed, *, file: bool = True) -> _Products:
        """Return the products of all parts and of what is held to the file.

        Without `file` what the parameter file says is left out.
        """
        C = crossed.total.C
        D = crossed.total.D
        if not any(term.absorbed_by_file for term in crossed.terms):
            return _Products(C=C, D=D)

        R = np.hstack([self.in_file(term) for term in crossed.terms])
        PR = self._held_times(R, file=file)
        D_coupled = [
            of_term + R[:, at].T @ PR[:, at]
            for of_term, at in zip(D, crossed.where, strict=True)
        ]
        return _Products(C=C + self._felt(PR), D=D_coupled)

    def _fits_beside(
        self, solution: _Solution, crossed: _Crossed, products: _Products
    ) -> list[TermFit]:
        """Return what each term by itself does to a solved model."""
        Z = self._halved(solution.factor, products.C)
        residual_product = crossed.total.d - products.C.T @ solution.theta

        # Terms of one size at once: one by one, the calls take longer than the sums.
        numbers_of_size: dict[int, list[int]] = {}
        for number, term in enumerate(crossed.terms):
            numbers_of_size.setdefault(term.size, []).append(number)
        fit_of: dict[int, TermFit] = {}
        Z_rows = np.ascontiguousarray(Z.T)
        for size, numbers in numbers_of_size.items():
            first = np.array([crossed.where[number].start for number in numbers])
            columns = first[:, None] + np.arange(size)
            half = Z_rows[columns]
            D = np.stack([products.D[number] for number in numbers])
            D_rows = np.stack([crossed.total.D[number] for number in numbers])
            S = D - half @ np.swapaxes(half, -1, -2)
            precision = np.stack(
                [crossed.terms[number].precision for number in numbers]
            )
            factors = algebra.bayes_factor(S, residual_product[columns], precision)
            square = np.maximum(np.trace(D_rows, axis1=-2, axis2=-1), 1e-300)
            visible = np.maximum(np.trace(S, axis1=-2, axis2=-1) / square, 0.0)
            for i, number in enumerate(numbers):
                fit_of[number] = TermFit(
                    log_bayes_factor=float(factors.log_factor[i]),
                    coefficients=factors.coefficients[i],
                    covariance=factors.covariance[i],
                    visible_share=float(visible[i]),
                )
        return [fit_of[number] for number in range(len(crossed.terms))]

    def _crossed(self, terms: Sequence[ColumnGroup], *, by_part: bool) -> _Crossed:
        """Return products of terms with all else, the logs' own columns out.

        Terms with the same columns share their products: these take most of the time.
        What each part is worth takes room, and is left out unless asked for.
        """
        where = _slices(term.size for term in terms)
        n_columns = where[-1].stop
        n_parts = self.rows.parts if by_part else 0
        C = np.zeros((n_parts, self.size, n_columns))
        d = np.zeros((n_parts, n_columns))
        D = [np.zeros((n_parts, term.size, term.size)) for term in terms]
        total = _Total(
            C=np.zeros((self.size, n_columns)),
            d=np.zeros(n_columns),
            D=[np.zeros((term.size, term.size)) for term in terms],
        )
        of_parts = [
            _Total(C=C[part], d=d[part], D=[of_term[part] for of_term in D])
            for part in range(n_parts)
        ]

        # The first of the terms with the same columns, for every term.
        first_of = dict[tuple[int, ...], int]()
        keys = [(term.size, *map(id, term.columns.values())) for term in terms]
        original = [first_of.setdefault(key, i) for i, key in enumerate(keys)]

        for channel, base in enumerate(self._columns):
            present = [i for i in first_of.values() if channel in terms[i].columns]
            if not present:
                continue
            groups = [terms[i] for i in present]
            places = []
            for i in present:
                of_term = np.arange(where[i].start, where[i].stop)
                places.append(of_term[terms[i].at(channel)])
            place = _Place(
                base=base.index,
                columns=np.concatenate(places),
                terms=present,
                inside=[terms[i].at(channel) for i in present],
            )

            precise = self._precise(channel, groups)
            logs = self.rows.log_slices[channel]
            every_row = slice(0, len(self.rows.y[channel]))
            if by_part:
                by_block = [
                    self._term_products(channel, groups, rows, [rows], precise)
                    for rows in self.rows.block_slices[channel]
                ]
                for part, of_block in zip(self.rows.part, by_block, strict=True):
                    place.add(of_block, total)
                    place.add(of_block, of_parts[part])
            else:
                by_block = [
                    self._term_products(channel, groups, every_row, logs, precise)
                ]
                place.add(by_block[0], total)

            own = self._own[channel]
            if own is None:
                continue
            own_products = by_block[0].own
            if by_part:
                own_products = np.zeros((len(logs), *own_products.shape[1:]))
                of_blocks = [of_block.own[0] for of_block in by_block]
                np.add.at(own_products, self.rows.log, of_blocks)
            sizes = [len(of_term) for of_term in by_block[0].D]
            halved = np.asarray(np.linalg.solve(own.root, own_products))
            place.add(_explained(own.base, own.y, halved, sizes), total)

            # A part takes its share from its logs' own columns as well.
            for part, of_part in enumerate(of_parts):
                blocks = self.rows.blocks_of_part[part]
                for log in np.unique(self.rows.log[blocks]).tolist():
                    others = self._without_part[part].eliminated.get((channel, log))
                    if others is None:
                        continue  # without rows here
                    in_log = blocks[self.rows.log[blocks] == log]
                    own_of_part = sum(by_block[block].own[0] for block in in_log)
                    by_all = _explained(own.base[log], own.y[log], halved[log], sizes)
                    of_others = others.halved(own_products[log] - own_of_part)
                    by_others = _explained(others.base, others.y, of_others, sizes)
                    place.add(by_all, of_part)
                    place.add(by_others.negated, of_part)

        for i, first in enumerate(original):
            if i != first:
                for products in (C, total.C):
                    products[..., where[i]] = products[..., where[first]]
                for products in (d, total.d):
                    products[..., where[i]] = products[..., where[first]]
                D[i] = D[first]
                total.D[i] = total.D[first]
        return _Crossed(terms=terms, where=where, C=C, d=d, D=D, total=total)

    def _term_products(
        self,
        channel: int,
        terms: Sequence[ColumnGroup],
        rows: slice,
        logs: Sequence[slice],
        precise: Array | None,
    ) -> _TermProducts:
        """Return products of terms with a channel's columns, over some of its rows.

        With the logs' own columns they are told apart by the rows of each log.
        `precise` are all rows of the terms' columns as `_precise` returns them.
        """
        columns = self._columns[channel]
        of_log = columns.of_log
        sizes = [term.columns[channel].shape[1] for term in terms]
        edges = np.cumsum(sizes)[:-1]
        C = np.zeros((len(columns.index), sum(sizes)))
        d = np.zeros(sum(sizes))
        D = [np.zeros((size, size)) for size in sizes]
        n_own = 0 if of_log is None else len(of_log.precision)
        own = np.zeros((len(logs), n_own, sum(sizes)))
        for tile in tiles(rows.stop, rows.start):
            X_each = [term.columns[channel][tile] for term in terms]
            if precise is None:
                wX = _weighted(self.weight[channel][tile], X_each)
            else:
                wX = precise[tile]
            if columns.groups:  # none above a cut-off
                C += np.vstack([B[tile].T @ wX for B in columns.groups])
            d += self.rows.y[channel][tile] @ wX
            wX_each = np.split(wX, edges, axis=1)
            for of_term, X, wX_of_term in zip(D, X_each, wX_each, strict=True):
                of_term += X.T @ wX_of_term
            if of_log is None:
                continue
            for number, log in enumerate(logs):
                start = max(log.start, tile.start)
                stop = min(log.stop, tile.stop)
                if start < stop:
                    inside = wX[start - tile.start : stop - tile.start]
                    own[number] += of_log.columns[start:stop].T @ inside
        return _TermProducts(C=C, d=d, D=tuple(D), own=own)

    def _precise(self, channel: int, terms: Sequence[ColumnGroup]) -> Array | None:
        """Return all rows of the columns of terms times their precision.

        None where rows are independent, so that some of them may be taken alone.
        """
        recurring = self.recurring[channel]
        if recurring is None:
            return None
        columns = [term.columns[channel] for term in terms]
        scaled = _weighted(self._root[channel], columns)
        precise = recurring.taken_off_twice(scaled)
        precise *= self._root[channel][:, None]
        return precise


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where products of a channel stand among those of all channels.

    Attributes
    ----------
    base : (p_c,) index array
        The parameters that the channel knows.
    columns : (m,) index array
        The columns of its terms.
    terms : sequence of int
        Their numbers.
    inside : sequence of slice
        Which of each term's columns the channel has.
    """

    base: Index
    columns: Index
    terms: Sequence[int]
    inside: Sequence[slice]

    def add(self, part: _TermProducts, total: _Total) -> None:
        """Add products of the channel to the sums of all channels, in place."""
        total.C[np.ix_(self.base, self.columns)] += part.C
        total.d[self.columns] += part.d
        for number, at, of_term in zip(self.terms, self.inside, part.D, strict=True):
            total.D[number][at, at] += of_term


@dataclass(frozen=True, kw_only=True)
class _TermProducts:
    """Products of m columns of terms over some rows of a channel.

    Attributes
    ----------
    C : (p_c, m) array
        With the base.
    d : (m,) array
        With the rows.
    D : tuple of (k, k) arrays
        Of each term with itself.
    own : (L, s, m) array
        With the own columns of L logs.
    """

    C: Array
    d: Array
    D: tuple[Array, ...]
    own: Array

    @property
    def negated(self) -> _TermProducts:
        """The same with the other sign."""
        D = tuple(-of_term for of_term in self.D)
        return _TermProducts(C=-self.C, d=-self.d, D=D, own=self.own)


def _explained(
    base: Array, y: Array, halved: Array, sizes: Sequence[int]
) -> _TermProducts:
    """Return what own columns of logs explain of products, with the other sign.

    Parameters
    ----------
    base, y, halved : (..., s, p_c), (..., s) and (..., s, m) arrays
        R^-1 S'wB, R^-1 S'wy and R^-1 S'wX of one log or of several.
    sizes : sequence of int
        Numbers of columns of each term.
    """
    flat = halved.reshape(math.prod(halved.shape[:-1]), halved.shape[-1])
    edges = np.cumsum(sizes)[:-1]
    parts = np.split(flat, edges, axis=1)
    return _TermProducts(
        C=-base.reshape(math.prod(base.shape[:-1]), base.shape[-1]).T @ flat,
        d=-(y.ravel() @ flat),
        D=tuple(-(part.T @ part) for part in parts),
        own=np.zeros((0, 0, flat.shape[-1])),
    )


class _Products(NamedTuple):
    """Products C (p, m) of terms with the base, and D (k, k) of each with itself."""

    C: Array
    D: list[Array]


@dataclass(frozen=True, kw_only=True)
class _Crossed:
    """Products of terms with the model's columns, the rows and themselves.

    Those of a part are what all rows have more than all other parts.
    """

    terms: Sequence[ColumnGroup]
    where: list[slice]
    C: Array  # (parts, p, m)
    d: Array  # (parts, m)
    D: list[Array]  # (parts, k, k) of each term
    total: _Total


class _Total(NamedTuple):
    """Products C (p, m), d (m,), and D (k, k) of each term, of all parts."""

    C: Array
    d: Array
    D: list[Array]


def _slices(sizes: Iterable[int]) -> list[slice]:
    """Return places of so many numbers each, one after the other."""
    edges: list[int] = np.cumsum([0, *sizes]).tolist()
    return [slice(start, stop) for start, stop in pairwise(edges)]


def _weighted(weight: Array, columns: Sequence[Array]) -> Array:
    """Return columns (M, k) each, side by side and times a weight (M,).

    One column after the other in memory: groups have a few columns each, and a product
    along the rows of such a group is slow.
    """
    sizes = [group.shape[1] for group in columns]
    result = np.empty((sum(sizes), len(weight)))
    for group, at in zip(columns, _slices(sizes), strict=True):
        np.multiply(group.T, weight, out=result[at])
    return result.T
