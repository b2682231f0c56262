"""Step 2 of the friction surface: entries over q and speed (Eq. 9-10), and orders.

Both steps together are the generalised least squares of the whole surface, terms of
high degree held back by what the data say of their size (`prior`). Such a surface may
have the paper's orders (10, 11) and does not swing between the speeds (Runge). Those
that are kept are the fewest with which it stays the same: within `DEVIATION` of its
standard errors.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.identify.friction_surface import reduction
from seqid_cli.identify.friction_surface.prior import (
    EntryPosterior,
    Evidence,
    Normal,
    Sizes,
)
from seqid_cli.identify.friction_surface.reduction import Orders, Reduced, SpeedData
from seqid_cli.model.friction_basis import tensor
from seqid_cli.typing import Array, Mask

DEVIATION = 0.15  # standard errors, RMS, by which a surface of fewer orders may differ
CELLS = 17  # per axis, at which two surfaces are compared
# orders over position and velocity that the user fixes
FixedOrders = tuple[int | None, int | None]


@dataclass(frozen=True)
class SharedTerm:
    """An error of all trials beside a surface, in standard deviations of its prior.

    `moves` (k,) N m: change of the surface's entries, row-major, per standard deviation
    by which the error is larger.
    """

    value: float
    std_error: float
    moves: Array


@dataclass(frozen=True)
class ErrorGrid:
    """Cells over both ranges, at which surfaces are compared.

    `columns` (CELLS^2, k) is the basis there, `std_error` (CELLS^2,) N m the standard
    error of the surface of the highest orders.
    """

    columns: Array
    std_error: Array


@dataclass(frozen=True)
class SurfaceFit:
    """One surface from trials, to be had with any orders up to the `highest`."""

    reduced: Reduced
    sizes: Sizes
    highest: Orders

    @cached_property
    def prior(self) -> Array:
        """Standard deviations (size + 6, l + 1) of the entries of the whole surface."""
        return self.sizes.prior(self.reduced.scaling, self.reduced.size, self.highest)

    @cached_property
    def normal(self) -> Normal:
        """The normal equations of these entries."""
        return Normal.of(self.reduced, self.sizes, self.highest.velocity)

    @cached_property
    def highest_posterior(self) -> EntryPosterior:
        """Entries (k,) of the surface of the highest orders, and covariance (k, k)."""
        return self.normal.posterior(self.prior.ravel())

    def entries(self, orders: Orders) -> Array:
        """Return the entries (size, l + 1) N m of a surface of fewer orders."""
        return self._solved(self.normal.N, self.normal.b, orders)

    def covariance(self, orders: Orders) -> Array:
        """Return the covariance of those entries, row-major.

        It has the mean variance of the whole surface over both ranges: what is left out
        errs too.
        """
        places = np.flatnonzero(self._mask(orders))
        covariance = self.highest_posterior.covariance[np.ix_(places, places)]
        columns = self._grid.columns[:, places]
        squares = np.einsum("nk,kl,nl->", columns, covariance, columns, optimize=True)
        highest_squares = float(np.sum(self._grid.std_error**2))
        return np.asarray(
            covariance * max(highest_squares / max(float(squares), 1e-300), 1.0)
        )

    def shared_term(self, orders: Orders, place: int) -> "SharedTerm":
        """Return an error that all trials share, and its effect on a surface's entries.

        Parameters
        ----------
        orders : Orders
            Of the surface.
        place : int
            Of the term behind the functions of position, `reduction.LATE` or
            `reduction.WARM`.
        """
        row = (self.reduced.size + place) * (self.highest.velocity + 1)
        mean = self.highest_posterior.mean
        covariance = self.highest_posterior.covariance
        variance = float(covariance[row, row])
        places = np.flatnonzero(self._mask(orders))
        return SharedTerm(
            value=float(mean[row]),
            std_error=float(np.sqrt(variance)),
            moves=covariance[places, row] / max(variance, 1e-300),
        )

    def leaving_out(self, orders: Orders) -> Iterator[tuple[float, Array]]:
        """Yield each inner speed u, and the entries fitted to all speeds but u."""
        for u in self.reduced.levels[1:-1]:
            at_speed = self.reduced.subset(self.reduced.u == u)
            part = Normal.of(at_speed, self.sizes, self.highest.velocity)
            N = self.normal.N - part.N
            b = self.normal.b - part.b
            yield float(u), self._solved(N, b, orders)

    def deviation(self, orders: Orders) -> float:
        """Return the RMS difference from the whole surface, in its standard errors."""
        entries = np.zeros(self.prior.size)
        entries[self._mask(orders)] = self.entries(orders).ravel()
        difference = self._grid.columns @ (entries - self.highest_posterior.mean)
        return float(np.sqrt(np.mean((difference / self._grid.std_error) ** 2)))

    def scaled_speeds(self, data: Sequence[SpeedData]) -> Array:
        """Return the scaled speeds (T,) of trials, as the reduction has them."""
        speeds = self.reduced.speeds.tolist()
        u_by_speed = dict(zip(speeds, self.reduced.u.tolist(), strict=True))
        return np.array([u_by_speed[item.speed] for item in data])

    def distances(self, data: Sequence[SpeedData]) -> list[Array]:
        """Return distances (K,) N m of slices from the surface plus trial's offset.

        The surface has the highest orders. A trial's offset is the median of its
        slices.
        """
        over_position = self.reduced.scaling.over_position
        order = over_position.order(self.reduced.size)
        D = self.highest_posterior.mean.reshape(self.prior.shape)[: self.reduced.size]
        levels = D @ chebvander(self.scaled_speeds(data), self.highest.velocity).T
        distances = []
        for k, item in enumerate(data):
            surface = over_position.values(item.q, order) @ levels[:, k]
            distance = item.friction - surface
            distances.append(distance - np.median(distance))
        return distances

    def trial_columns(self, item: SpeedData) -> Array:
        """Return functions (K, size + 2) of a trial's own terms, at its slices."""
        over_position = self.reduced.scaling.over_position
        values = over_position.values(item.q, over_position.order(self.reduced.size))
        return np.hstack([values, item.edges])

    def trial_variances(self, item: SpeedData) -> Array:
        """Return variances (size + 2,) of a trial's coefficients of `trial_columns`."""
        variances = self.sizes.trial_variances(
            self.reduced.scaling, self.reduced.size, np.array([item.speed])
        )
        of_trial = variances.sum(axis=0)[0]
        return np.asarray(of_trial[: self.reduced.size + reduction.EDGES])

    @cached_property
    def _grid(self) -> ErrorGrid:
        """Cells over both ranges, with the whole surface's standard errors there."""
        over_position = self.reduced.scaling.over_position
        share = np.linspace(0.0, 1.0, CELLS)
        order = over_position.order(self.reduced.size)
        X = over_position.values(over_position.at(share), order)
        T = chebvander(2.0 * share - 1.0, self.highest.velocity)
        X = np.hstack([X, np.zeros((CELLS, len(self.prior) - X.shape[1]))])
        columns = tensor(np.repeat(X, CELLS, axis=0), np.tile(T, (CELLS, 1)))
        variance = np.einsum(
            "nk,kl,nl->n",
            columns,
            self.highest_posterior.covariance,
            columns,
            optimize=True,
        )
        return ErrorGrid(columns, np.sqrt(np.maximum(variance, 1e-300)))

    def _mask(self, orders: Orders) -> Mask:
        """Return which of the surface's entries have these orders, row-major.

        Raises ValueError of orders beyond the `highest`: the trials are not reduced to
        such functions, and a slice would leave them out without a word.
        """
        if (
            orders.position > self.highest.position
            or orders.velocity > self.highest.velocity
        ):
            raise ValueError(f"{orders} are beyond the highest, {self.highest}")
        mask = np.zeros(self.prior.shape, dtype=np.bool_)
        size = self.reduced.scaling.over_position.size(orders.position)
        mask[:size, : orders.velocity + 1] = True
        return mask.ravel()

    def _solved(self, N: Array, b: Array, orders: Orders) -> Array:
        """Return entries (size, l + 1) of a surface, beside what all trials share."""
        of_surface = self._mask(orders)
        shared = self.prior > 0.0
        shared[: self.reduced.size] = False
        fitted = of_surface | shared.ravel()
        prior = self.prior.ravel()[fitted]
        inner = N[np.ix_(fitted, fitted)] * np.outer(prior, prior)
        inner[np.diag_indices_from(inner)] += 1.0
        solved: Array = prior * np.linalg.solve(inner, prior * b[fitted])
        return solved[of_surface[fitted]].reshape(-1, orders.velocity + 1)


def highest_orders(sets: Sequence[Reduced], fixed: FixedOrders) -> Orders:
    """Return the orders that the data, or the user, allow at most."""
    position, velocity = fixed
    if position is None:
        position = sets[0].highest_position_order
    if velocity is None:
        n_speeds = min(len(trials.levels) for trials in sets)
        velocity = min(reduction.MAX_VELOCITY_ORDER, max(n_speeds - 1, 0))
    return Orders(position, velocity)


def fit_surfaces(
    sets: Sequence[Reduced],
    fixed: FixedOrders = (None, None),
    near: Sizes | None = None,
) -> tuple[list[SurfaceFit], float]:
    """Fit one surface to each set of trials, with sizes of terms and errors in common.

    Parameters
    ----------
    sets : sequence of Reduced
        Sets of trials.
    fixed : tuple of int or None
        Orders over position and velocity that the user fixes.
    near : Sizes, optional
        Sizes that the search starts from.

    Returns
    -------
    fits : list of SurfaceFit
        One for each set.
    evidence : float
        Twice the log marginal likelihood.
    """
    highest = highest_orders(sets, fixed)
    sizes, evidence = Evidence(sets, highest).strongest(near)
    return [SurfaceFit(trials, sizes, highest) for trials in sets], evidence


def choose_orders(
    fits: Sequence[SurfaceFit],
    fixed: FixedOrders,
    *,
    accept: Callable[[Orders], bool] | None = None,
) -> Orders:
    """Choose the fewest orders that `accept`, else the fewest as good as the highest.

    Parameters
    ----------
    fits : sequence of SurfaceFit
        One surface for both directions, or one for each.
    fixed : tuple of int or None
        Orders over position and velocity that the user fixes.
    accept : callable, optional
        Whether orders are enough, such as Eq. 11. Where none are, as noise may have it,
        the data decide as they do without it: within `DEVIATION` of the surface of the
        highest orders.
    """
    highest = fits[0].highest
    size = fits[0].reduced.scaling.over_position.size
    position, velocity = fixed
    lowest = min(1, highest.velocity) if velocity is None else velocity
    steps = [
        Orders(m, l)
        for m in range(position or 0, highest.position + 1)
        for l in range(lowest, highest.velocity + 1)
    ]
    steps.sort(key=lambda orders: size(orders.position) * (orders.velocity + 1))
    if accept is not None:
        accepted = next((orders for orders in steps if accept(orders)), None)
        if accepted is not None:
            return accepted

    def supported(orders: Orders) -> bool:
        return all(fit.deviation(orders) <= DEVIATION for fit in fits)

    return next((orders for orders in steps[:-1] if supported(orders)), steps[-1])
