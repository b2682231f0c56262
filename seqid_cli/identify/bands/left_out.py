"""Residuals of samples by a fit that has not seen them.

Of a fit with the weighted normal matrix A (its inverse is `bread`) and a left-out part
with normal matrix A_F and score s_F = H_F' r_F / sigma^2, the parameters without the
part, and its residuals by them, are

    theta_F = theta - (A - A_F)^-1 s_F,    r_F + H_F (A - A_F)^-1 s_F.

With B B' = bread and the eigenvalues mu of B' A_F B, all between 0 and 1, (A - A_F)^-1
is B U (1 - mu)^-1 U' B'. A direction with mu near 1 is known from this part alone:
without it, there would be no prediction at all. Such a part is no fair test of a model
that has seen it.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.bands.rows import BandRows
from seqid_cli.typing import Array, Index

# of what is known of a direction, that a part may hold to be left out
LARGEST_SHARE = 0.9
# whole logs are left out from so many on, in so many parts
FEWEST_LOGS, MOST_FOLDS = 3, 10
STRETCHES = 5  # of every log, else


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A weighted least-squares fit: `theta` (p,), `bread` (p, p), by joint `sigma` (n,) N m.

    `independent` is the share of samples that count, as in `least_squares.solve`.
    Predictions use the first `predicting` unknowns alone (all where it is None): what
    is marginalised, a delay that the measured torque shows, is of no use to them.
    """

    theta: Array
    bread: Array
    sigma: Array
    independent: float = 1.0
    predicting: int | None = None

    @property
    def predictors(self) -> slice:
        """Places of the unknowns that predictions use."""
        return slice(0, self.predicting)


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Residuals (M, n) N m of left-out samples, and the number (M,) of each one's fold."""

    residual: Array
    fold: Index
    kind: str  # "logs" or "stretches"

    @property
    def folds(self) -> int:
        """Number of folds."""
        return len(np.unique(self.fold))


def left_out_residuals(rows: BandRows, fit: Fit) -> LeftOut:
    """Return residuals by fits without whole logs; without stretches of time where logs are few.

    Whole logs show more: how friction differs from one day to the next, how a model
    does on a motion of another kind. But a log that alone shows a direction cannot be
    spared.
    """
    logs = int(rows.log.max()) + 1
    if logs >= FEWEST_LOGS:
        fold = rows.log * min(logs, MOST_FOLDS) // logs
        residual, largest_share = _without_folds(rows, fit, fold)
        if largest_share <= LARGEST_SHARE:
            return LeftOut(residual=residual, fold=fold, kind="logs")

    fold = _stretches(rows)
    residual, _ = _without_folds(rows, fit, fold)
    return LeftOut(residual=residual, fold=fold, kind="stretches")


def _stretches(rows: BandRows) -> Index:
    """Return folds (M,): stretch k of every log is of fold k."""
    fold = np.zeros(rows.samples, dtype=np.intp)
    for log in np.unique(rows.log):
        own = np.flatnonzero(rows.log == log)
        fold[own] = np.arange(len(own)) * STRETCHES // len(own)
    return fold


def _without_folds(rows: BandRows, fit: Fit, fold: Index) -> tuple[Array, float]:
    """Return residuals (M, n) N m without each fold, and the largest share that one holds."""
    fitted = rows.y - rows.H @ fit.theta
    places = fit.predictors
    residual = rows.y - rows.H[:, :, places] @ fit.theta[places]
    root = _root(fit.bread)
    left_out = residual.copy()
    largest_share = 0.0

    for number in np.unique(fold):
        own = rows.part(fold == number)
        own_fitted = fitted[fold == number]

        # Columns in units in which the whole fit's normal matrix is the identity.
        scale = np.sqrt(own.weight * fit.independent)[:, None] / fit.sigma
        scale = np.where(own.used, scale, 0.0)
        columns = ((own.H * scale[..., None]) @ root).reshape(-1, root.shape[1])
        score = columns.T @ (scale * own_fitted).ravel()

        share, directions = np.linalg.eigh(columns.T @ columns)
        largest_share = max(largest_share, float(share.max(initial=0.0)))
        share = np.clip(share, 0.0, LARGEST_SHARE)
        change = root @ (directions @ ((directions.T @ score) / (1.0 - share)))
        by_change = own.H[:, :, places] @ change[places]
        left_out[fold == number] = residual[fold == number] + by_change
    return left_out, largest_share


def _root(bread: Array, *, rounding: float = 1e-12) -> Array:
    """Return B (p, r) with B B' = bread; directions that are not known are left out."""
    scale = np.sqrt(np.diag(bread))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(bread / np.outer(scale, scale))
    kept = values > rounding * max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))
