"""Whether a quantity changed: steps between two dates, and drifts, against their errors.

The values x_t of one quantity, with standard errors s_t at times t, are

    x_t = m + b (T_t - T) + d c_t + c s_t e_t,

T_t the temperature where it is known, b known to be about zero within `per_kelvin` of m, and c_t
either a step between two dates or a line over time. Results of separate recordings scatter more
than their standard errors say, by what is the same within a recording; the inflation c >= 1 is the
median of the differences of neighbouring dates over their errors, of all robots and quantities of
one stage together: few that change do not move it. With less than `enough` differences the
standard errors are taken as they are.

The z-score of d is held against Student's distribution, all steps and lines of all quantities
counted (Bonferroni). The hypothesis with the largest |z| of a quantity is the one that is told.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from seqid_cli.robot.types import Array
from seqid_cli.robust import gaussian_spread
from seqid_cli.trend.series import Series


@dataclass(frozen=True)
class Change:
    """The best hypothesis on one quantity; `at` is the first date after a step, 0 of a drift."""

    series: Series
    kind: str
    at: int
    before: float
    after: float
    std_error: float

    @property
    def change(self) -> float:
        """From before to after."""
        return self.after - self.before

    @property
    def sigmas(self) -> float:
        """Standard errors of the change."""
        return abs(self.change) / self.std_error if self.std_error > 0.0 else float("inf")

    def relative(self, least: float) -> float:
        """Change as a share of the quantity's size, `least` at least."""
        size = max(abs(self.before), abs(self.after), least)
        return self.change / size if size > 0.0 else 0.0


@dataclass(frozen=True)
class Scatter:
    """By how much values scatter beyond their errors, and how many differences say so (0: none)."""

    inflation: float
    differences: int


def scatter_of(series: Iterable[Series], *, enough: int = 30) -> Scatter:
    """Inflation of the standard errors of quantities of one stage."""
    ratios = [
        np.diff(own.values) / np.hypot(own.errors[1:], own.errors[:-1])
        for own in series
        if (own.errors > 0.0).all()
    ]
    every = np.concatenate(ratios) if ratios else np.zeros(0)
    if len(every) < enough:
        return Scatter(1.0, 0)
    return Scatter(max(float(gaussian_spread(every)), 1.0), len(every))


def limit_of(series: Sequence[Series], scatters: Iterable[Scatter], alpha: float) -> float:
    """The |z| that any hypothesis on healthy robots exceeds with the probability `alpha`."""
    hypotheses = sum(len(own.values) for own in series)  # a step between any two dates, and a line
    share = alpha / (2 * max(hypotheses, 1))
    told = [s.differences for s in scatters if s.differences]
    return float(stats.t.isf(share, min(told) / 2) if told else stats.norm.isf(share))


def best_change(series: Series, inflation: float) -> Change:
    """The step or drift that a quantity's values tell most clearly."""
    count, days = len(series.values), series.days
    tried = [("step", k, (np.arange(count) >= k).astype(np.float64)) for k in range(1, count)]
    if count > 2 and days[-1] > 0.0:
        tried.append(("drift", 0, days / days[-1]))
    found = [_fitted(series, inflation, kind, at, column) for kind, at, column in tried]
    return max(found, key=lambda change: change.sigmas)


def _fitted(
    series: Series, inflation: float, kind: str, at: int, column: Array, *, per_kelvin: float = 0.02
) -> Change:
    """Generalised least squares for one hypothesis."""
    errors = inflation * series.errors
    least = 1e-12 * max(float(np.abs(series.values).max()), 1e-300)
    root = 1.0 / np.maximum(errors, least)
    warmth = series.temperatures
    known = bool(np.isfinite(warmth).all())
    warmer = warmth - warmth.mean() if known else np.zeros(len(column))
    A = np.column_stack([np.ones(len(column)), column, warmer]) * root[:, None]
    size = max(float(np.abs(series.values).mean()), least)
    rows = np.vstack([A, [0.0, 0.0, 1.0 / (per_kelvin * size)]])
    y = np.append(series.values * root, 0.0)
    covariance = np.linalg.pinv(rows.T @ rows, hermitian=True, rcond=1e-14)
    theta = covariance @ (rows.T @ y)
    error = float(np.sqrt(max(covariance[1, 1], 0.0)))
    return Change(series, kind, at, float(theta[0]), float(theta[0] + theta[1]), error)
