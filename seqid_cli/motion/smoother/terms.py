"""Pieces of the motion smoother: splines, what measurements say of them, and their jerk.

The trajectory of a joint is a cubic spline, its jerk constant between knots. In interval k the
position, velocity and acceleration depend on the coefficients k to k + 3 alone, so states
(q, dq, ddq) driven by white jerk take one unknown per knot.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.typing import Array

JERK = np.array([-1.0, 3.0, -3.0, 1.0])


def spline_weights(u: Array, spacing: float) -> Array:
    """Weights (len(u), 3, 4) of four coefficients in q, dq, ddq at `u` in [0, 1) of an interval."""
    one, none = np.ones_like(u), np.zeros_like(u)
    q = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    dq = [-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + one, u**2]
    ddq = [1 - u, 3 * u - 2, 1 - 3 * u, u + none]
    weights = [np.array(q) / 6, np.array(dq) / 2 / spacing, np.array(ddq) / spacing**2]
    return np.array(weights).transpose(2, 0, 1)


class Band:
    """Sums information of intervals: row k + d, column k, of each joint with itself."""

    def __init__(self, intervals: int, n: int) -> None:
        self.own = np.zeros((4, intervals + 3, n))
        self.gradient = np.zeros((intervals + 3, n))
        self.intervals = intervals

    def add(self, rows: Array, weights: Array, pulls: Array) -> None:
        """Add measurements by `rows` (S, 4): `weights` (S, M or 1, n), `pulls` (S, M, n)."""
        m = self.intervals
        for a in range(4):
            self.gradient[a : a + m] += np.tensordot(rows[:, a], pulls, 1)
            for b in range(a + 1):
                both = rows[:, a] * rows[:, b]
                if both.any():
                    self.own[a - b, b : b + m] += np.tensordot(both, weights, 1)

    def by_joint(self) -> Array:
        """Lower band (4, nK) of joints one after the other, where nothing couples them."""
        return self.own.transpose(0, 2, 1).reshape(4, -1)

    def added_to(self, band: Array) -> Array:
        """Add to LAPACK's band (K, n, 4n): entry r of coefficient (k, j) is in row kn + j + r."""
        n = band.shape[1]
        for d in range(4):
            band[:, :, d * n] += self.own[d]
        return band


@dataclass(frozen=True)
class Jerk:
    """White jerk of all joints: `size` (n,) rad/s^3 between knots, `correlation` (n, n).

    A jolt of one joint jolts the others through the arm's inertia: jerks come together. `relative`
    (M, n) is how much larger than usual they are in each interval: friction jolts a joint that
    turns back, and an arm that rests has none.
    """

    size: Array
    correlation: Array
    relative: Array

    @property
    def precision(self) -> Array:
        """Inverse covariance (n, n) of the usual jerk."""
        covariance = self.correlation * np.outer(self.size, self.size)
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def couple_jerks(band: Array, precision: Array, relative: Array, *, stretch: int = 512) -> None:
    """Add what the jerks' precision between joints says to a lower band (K, n, 4n)."""
    if not precision.any():
        return
    inverse = 1.0 / relative
    for start in range(0, len(inverse), stretch):
        own = inverse[start : start + stretch]
        couplings = own[:, :, None] * own[:, None] * precision
        m, n = own.shape
        for d in range(4):
            share = np.zeros((m + 3, n, n))
            for b in range(4 - d):
                share[b : b + m] += (JERK[b + d] * JERK[b]) * couplings
            for j in range(n):
                first = 0 if d else j
                columns = slice(d * n + first - j, (d + 1) * n - j)
                band[start : start + m + 3, j, columns] += share[:, j, first:]
