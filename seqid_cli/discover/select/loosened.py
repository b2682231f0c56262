"""What a solved model's evidence is where parts of it are held otherwise; no fit is repeated."""

import numpy as np

from seqid_cli.discover.select.algebra import factored, half_log_det, scale_of
from seqid_cli.discover.select.linear import Linear
from seqid_cli.typing import Array


class Loosened:
    """A solved model while parts of what is held get other precisions, one after the other.

    With C the covariance of some of it, t their values and D what their precision grows by, all by
    those of before, the log evidence grows by (log det(P + D) - log det P - log det(1 + D C) - t'
    (1 + D C)^-1 D t) / 2.
    """

    def __init__(self, linear: Linear) -> None:
        self.theta = linear.held
        self.covariance = linear.lift @ linear.covariance @ linear.lift.T
        self._told = np.diag(linear.sums[0])  # by the rows

    def gained(self, at: slice, before: Array, after: Array) -> float:
        """Log evidence that other precisions (k, k) of some parameters gain."""
        t, K, spread = self.theta[at], *self._change(at, after - before)
        grown = self._half_log_det(at, after) - self._half_log_det(at, before)
        return grown - 0.5 * float(spread + t @ K @ t)

    def hold(self, at: slice, before: Array, after: Array) -> None:
        """Have them hold from now on."""
        C, K = self.covariance[:, at], self._change(at, after - before)[0]
        self.theta -= C @ (K @ self.theta[at])
        self.covariance -= C @ K @ C.T

    def _half_log_det(self, at: slice, precision: Array) -> float:
        scale = scale_of(np.diag(precision) + self._told[at])
        return half_log_det(factored(precision * np.outer(scale, scale))) - float(
            np.log(scale).sum()
        )

    def _change(self, at: slice, more: Array) -> tuple[Array, float]:
        """(1 + D C)^-1 D and the logarithm of the determinant of 1 + D C."""
        M = np.eye(len(more)) + more @ self.covariance[at, at]
        return np.asarray(np.linalg.solve(M, more)), float(np.linalg.slogdet(M)[1])
