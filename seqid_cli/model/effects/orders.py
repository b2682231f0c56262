"""Lines in a residual's spectrum over position, found in bins of position."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.optimize import minimize_scalar

from seqid_cli.typing import Array

BINS_PER_CYCLE = 4
MOST_BINS = 1 << 17
PADDING = 4  # of the Fourier transform, so that a line cannot fall between two of its values
TREND = 5  # terms of the smooth dependence on position that is taken out first
FLOOR_WINDOW = 64  # values of the spectrum over which its level is taken
XATOL = 5e-4  # of the half width of a line, to which its order is refined


@dataclass(frozen=True)
class Profile:
    """A residual r with its multiplier m, summed up over position in B bins.

    `x` (B,) is the mean position of each bin [turns], `rm` and `mm` (B,) the sums of r m and of m m
    in it, `span` the range of position [turns], `highest` the cycles per turn up to which the bins
    resolve lines.
    """

    x: Array
    rm: Array
    mm: Array
    span: float
    highest: float

    @classmethod
    def of(
        cls, x: Sequence[Array], r: Sequence[Array], m: Sequence[Array], highest: float
    ) -> Self | None:
        """Sum up samples x (N,) turns, r and m (N,) where r is not 0; None where they are few."""
        X, R, M = (np.concatenate(list(parts)) for parts in (x, r, m))
        counts = R != 0.0
        X, R, M = X[counts], R[counts], M[counts]
        if len(X) < 100 or np.ptp(X) <= 0.0:
            return None
        start, span = float(X.min()), float(np.ptp(X))
        bins = min(max(int(BINS_PER_CYCLE * highest * span), 16), MOST_BINS)
        at = np.minimum(((X - start) / span * bins).astype(np.intp), bins - 1)
        number = np.bincount(at, minlength=bins)
        centre = start + (np.arange(bins) + 0.5) * span / bins
        mean = np.bincount(at, weights=X, minlength=bins) / np.maximum(number, 1)
        mm = np.bincount(at, weights=M * M, minlength=bins).astype(np.float64)
        rm = np.bincount(at, weights=R * M, minlength=bins).astype(np.float64)
        position = np.where(number > 0, mean, centre)
        # A smooth dependence on position, scaled to [-1, 1], is taken out of r first.
        basis = chebvander(2 * (position - start) / span - 1, TREND - 1)
        weighted = basis * mm[:, None]
        rm = rm - weighted @ np.linalg.lstsq(weighted.T @ basis, basis.T @ rm, rcond=1e-10)[0]
        return cls(position, rm, mm, span, min(highest, bins / (BINS_PER_CYCLE * span)))

    def gain(self, order: float) -> float:
        """Squared residual that a sine of `order` cycles per turn explains, its phase free."""
        p = 2 * np.pi * order * self.x
        sin, cos = np.sin(p), np.cos(p)
        cross = float(self.mm @ (sin * cos))
        A = np.array([[self.mm @ (sin * sin), cross], [cross, self.mm @ (cos * cos)]])
        b = np.array([self.rm @ sin, self.rm @ cos])
        if np.linalg.det(A) < 1e-3 * float(np.trace(A)) ** 2:
            return 0.0
        return float(b @ np.linalg.solve(A, b))

    def spectrum(self) -> tuple[Array, Array]:
        """Orders and the gain that a well spread range of positions would give there."""
        lines = np.abs(np.fft.rfft(self.rm, PADDING * len(self.rm))) ** 2
        orders = np.arange(len(lines)) / (PADDING * self.span)
        return orders, 2.0 * lines / max(float(self.mm.sum()), 1e-300)


def peaks(profile: Profile, lowest: float, count: int) -> list[float]:
    """At most `count` orders from `lowest` on: half the strongest lines, half the clearest ones."""
    orders, power, clear = _lines(profile, lowest)
    if len(power) < 3:
        return []
    top = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    chosen: list[int] = []
    for score in (clear, power):
        found = 0
        for k in top[np.argsort(-score[top], kind="stable")]:
            if found == (count + 1) // 2:
                break
            if all(abs(k - other) > 2 * PADDING for other in chosen):
                chosen.append(int(k))
                found += 1
    return [_refined(profile, float(orders[k]), 1.0 / profile.span / PADDING) for k in chosen]


def clearest(profile: Profile, lowest: float) -> float:
    """How many times its surroundings' level the clearest line has; 0 where there are none."""
    return float(np.max(_lines(profile, lowest)[2], initial=0.0))


def clearness(profile: Profile, lowest: float, order: float) -> float:
    """How many times its surroundings' level the line nearest to an order has."""
    orders, _, clear = _lines(profile, lowest)
    return float(clear[np.argmin(np.abs(orders - order))]) if len(orders) else 0.0


def _lines(profile: Profile, lowest: float) -> tuple[Array, Array, Array]:
    """Orders from `lowest` on, their power, and how clear they stand above their surroundings."""
    orders, power = profile.spectrum()
    inside = (orders >= lowest) & (orders <= profile.highest)
    orders, power = orders[inside], power[inside]
    if len(power) == 0:
        return orders, power, power
    # Their level: medians of windows, joined by lines.
    parts = np.array_split(np.arange(len(power)), len(power) // min(FLOOR_WINDOW, len(power)))
    at, level = zip(*((part.mean(), np.median(power[part])) for part in parts), strict=True)
    floor = np.interp(np.arange(len(power)), at, level)
    return orders, power, power / np.maximum(floor, 1e-300)


def _refined(profile: Profile, order: float, width: float) -> float:
    """Best order within `width` of a peak."""
    near = (order - width, order + width)
    found = minimize_scalar(
        lambda x: -profile.gain(x), bounds=near, method="bounded", options={"xatol": XATOL * width}
    )
    return float(found.x)
