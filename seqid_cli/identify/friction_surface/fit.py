"""Step 2 of the friction surface: its entries over position and speed (Eq. 9-10), and its orders.

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

from seqid_cli.identify.friction_surface import reduction
from seqid_cli.identify.friction_surface.prior import Evidence, Normal, Sizes
from seqid_cli.identify.friction_surface.reduction import Orders, Reduced, SpeedData
from seqid_cli.model.friction_basis import tensor
from seqid_cli.typing import Array, Mask

DEVIATION = 0.15  # standard errors, RMS, by which a surface of fewer orders may differ
CELLS = 17  # per axis, at which two surfaces are compared
# orders over position and velocity that the user fixes
Asked = tuple[int | None, int | None]


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
class SurfaceFit:
    """One surface from trials, to be had with any orders up to the `highest`."""

    reduced: Reduced
    sizes: Sizes
    highest: Orders

    @cached_property
    def prior(self) -> Array:
        """Standard deviations (size, l + 1) of the entries of the whole surface."""
        return self.sizes.prior(self.reduced.scaling, self.reduced.size, self.highest)

    @cached_property
    def normal(self) -> Normal:
        """The normal equations of these entries."""
        return Normal.of(self.reduced, self.sizes, self.highest.velocity)

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """Entries (k,) of the whole surface and their covariance (k, k)."""
        return self.normal.posterior(self.prior.ravel())[:2]

    def entries(self, orders: Orders) -> Array:
        """Entries (size, l + 1) N m of a surface of fewer orders."""
        return self._solved(self.normal.N, self.normal.b, orders)

    def covariance(self, orders: Orders) -> Array:
        """Covariance of those entries, row-major."""
        # With the mean variance of the whole surface over both ranges: what is left out
        # errs too.
        kept = np.flatnonzero(self._kept(orders))
        found = self.whole[1][np.ix_(kept, kept)]
        columns, error = self._grid
        own = np.einsum(
            "nk,kl,nl->", columns[:, kept], found, columns[:, kept], optimize=True
        )
        return np.asarray(
            found * max(float(np.sum(error**2)) / max(float(own), 1e-300), 1.0)
        )

    def shared_term(self, orders: Orders, place: int) -> "SharedTerm":
        """Return an error that all trials share, and how the entries of a surface go with it.

        Parameters
        ----------
        orders : Orders
            Of the surface.
        place : int
            Of the term behind the functions of position, `reduction.LATE` or
            `reduction.WARM`.
        """
        row = (self.reduced.size + place) * (self.highest.velocity + 1)
        mean, covariance = self.whole
        variance = float(covariance[row, row])
        kept = np.flatnonzero(self._kept(orders))
        moves = covariance[kept, row] / max(variance, 1e-300)
        return SharedTerm(float(mean[row]), float(np.sqrt(variance)), moves)

    def leaving_out(self, orders: Orders) -> Iterator[tuple[float, Array]]:
        """Each inner speed u, with the entries of a surface fitted to the others."""
        for u in self.reduced.levels[1:-1]:
            own = self.reduced.subset(self.reduced.u == u)
            part = Normal.of(own, self.sizes, self.highest.velocity)
            yield (
                float(u),
                self._solved(self.normal.N - part.N, self.normal.b - part.b, orders),
            )

    def deviation(self, orders: Orders) -> float:
        """RMS difference from the whole surface, in its standard errors, over both ranges."""
        entries = np.zeros(self.prior.size)
        entries[self._kept(orders)] = self.entries(orders).ravel()
        columns, error = self._grid
        return float(
            np.sqrt(np.mean((columns @ (entries - self.whole[0]) / error) ** 2))
        )

    def distances(self, data: Sequence[SpeedData]) -> list[Array]:
        """Distances (K,) N m of slices from the whole surface and their trial's own offset."""
        over_position = self.reduced.scaling.over_position
        order = over_position.order(self.reduced.size)
        D = self.whole[0].reshape(self.prior.shape)[: self.reduced.size]
        levels = D @ self.reduced.over_speed(self.highest.velocity).T
        off = [
            item.friction - over_position.values(item.q, order) @ levels[:, k]
            for k, item in enumerate(data)
        ]
        return [each - np.median(each) for each in off]

    def trial_columns(self, item: SpeedData) -> Array:
        """Functions (K, size + 2) of what a trial has for itself, at its slices."""
        over_position = self.reduced.scaling.over_position
        values = over_position.values(item.q, over_position.order(self.reduced.size))
        return np.hstack([values, item.edges])

    def trial_variances(self, k: int) -> Array:
        """Variances (size + 2,) of the coefficients of `trial_columns` of trial k."""
        variances = self.sizes.own(
            self.reduced.scaling, self.reduced.size, self.reduced.speeds[[k]]
        )
        return np.asarray(
            variances.sum(axis=0)[0, : self.reduced.size + reduction.EDGES]
        )

    @cached_property
    def _grid(self) -> tuple[Array, Array]:
        """Basis (CELLS^2, k) over both ranges, and the whole surface's standard errors there."""
        over_position, share = (
            self.reduced.scaling.over_position,
            np.linspace(0.0, 1.0, CELLS),
        )
        X = over_position.values(
            over_position.at(share), over_position.order(self.reduced.size)
        )
        T = np.polynomial.chebyshev.chebvander(2.0 * share - 1.0, self.highest.velocity)
        X = np.hstack([X, np.zeros((CELLS, len(self.prior) - X.shape[1]))])
        columns = tensor(np.repeat(X, CELLS, axis=0), np.tile(T, (CELLS, 1)))
        variance = np.einsum(
            "nk,kl,nl->n", columns, self.whole[1], columns, optimize=True
        )
        return columns, np.sqrt(np.maximum(variance, 1e-300))

    def _kept(self, orders: Orders) -> Mask:
        """Which of the surface's entries have these orders, row-major."""
        kept = np.zeros(self.prior.shape, dtype=np.bool_)
        size = self.reduced.scaling.over_position.size(orders.position)
        kept[:size, : orders.velocity + 1] = True
        return kept.ravel()

    def _solved(self, N: Array, b: Array, orders: Orders) -> Array:
        """Entries (size, l + 1) of a surface; what all trials share is fitted beside them."""
        kept, fitted = self._kept(orders), self.prior > 0.0
        fitted[: self.reduced.size] = False
        both = kept | fitted.ravel()
        prior = self.prior.ravel()[both]
        inner = N[np.ix_(both, both)] * np.outer(prior, prior)
        inner[np.diag_indices_from(inner)] += 1.0
        solved: Array = prior * np.linalg.solve(inner, prior * b[both])
        return solved[kept[both]].reshape(-1, orders.velocity + 1)


def highest_orders(sets: Sequence[Reduced], asked: Asked) -> Orders:
    """The orders that the data, or the user, allow at most."""
    levels = min(len(own.levels) for own in sets)
    most = min(reduction.MAX_VELOCITY_ORDER, max(levels - 1, 0))
    position, velocity = asked
    allowed = reduction.MAX_POSITION_ORDER if position is None else position
    return Orders(allowed, most if velocity is None else velocity)


def fit_surfaces(
    sets: Sequence[Reduced], asked: Asked = (None, None), near: Sizes | None = None
) -> tuple[list[SurfaceFit], float]:
    """Fit one surface to each set of trials, with sizes of terms and errors in common."""
    # Sizes are searched from those `near`. Twice the log marginal likelihood comes
    # second.
    highest = highest_orders(sets, asked)
    sizes, evidence = Evidence(sets, highest).strongest(near)
    return [SurfaceFit(own, sizes, highest) for own in sets], evidence


def choose_orders(
    fits: Sequence[SurfaceFit],
    asked: Asked,
    *,
    accept: Callable[[Orders], bool] | None = None,
) -> Orders:
    """Choose the fewest orders that `accept`, else the fewest that do as well as the highest.

    Parameters
    ----------
    fits : sequence of SurfaceFit
        One surface for both directions, or one for each.
    asked : tuple of int or None
        Orders over position and velocity that the user fixes.
    accept : callable, optional
        Whether orders are enough, such as Eq. 11. Where none are, as noise may have it,
        the data decide as they do without it: within `DEVIATION` of the surface of the
        highest orders.
    """
    highest, size = fits[0].highest, fits[0].reduced.scaling.over_position.size
    position, velocity = asked
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
