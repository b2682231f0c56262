"""Residuals of samples by a fit that has not seen them.

A fit has the weighted normal matrix A, whose inverse is `bread`. A part F of its rows
has the normal matrix A_F and the score s_F = H_F' r_F / sigma^2. A fit without the part
has these parameters, and leaves these residuals of the part:

    theta_F = theta - (A - A_F)^-1 s_F,    r_F + H_F (A - A_F)^-1 s_F.

Let B B' = bread, and U and mu be the eigenvectors and eigenvalues of B' A_F B, all mu
between 0 and 1. Then (A - A_F)^-1 is B U (1 - mu)^-1 U' B'. A direction with mu near 1
is determined by this part alone, and a fit without the part could not predict along it.
Leaving out such a part is no fair test of a model that has seen it.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.bands.rows import BandRows
from seqid_cli.typing import Array, Index

# Largest share of the information on a direction in a part that may be left out.
LARGEST_SHARE = 0.9
FEWEST_LOGS = 3  # from which whole logs are left out
MOST_FOLDS = 10  # of whole logs
STRETCHES = 5  # of every log where logs are too few


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A weighted least-squares fit of p unknowns to the torques of n joints.

    Attributes
    ----------
    theta : array (p,)
        The estimate.
    bread : array (p, p)
        Inverse of the weighted normal matrix.
    sigma : array (n,)
        Standard deviation of each joint's torque noise [N m].
    independent : float
        Share of samples that count as independent, as in `least_squares.solve`.
    predicting : int or None
        Number of leading unknowns that predictions use; None for all. The rest is
        marginalised, as waves of friction, which this model's predictions lack.
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
    """Residuals (M, n) N m of left-out samples, with the fold (M,) of each sample."""

    residual: Array
    fold: Index
    kind: str  # "logs" or "stretches"

    @property
    def folds(self) -> int:
        """Number of folds."""
        return len(np.unique(self.fold))


def left_out_residuals(rows: BandRows, fit: Fit) -> LeftOut:
    """Return the residuals of samples by fits that have not seen them.

    Fits without whole logs show how friction differs from day to day, and how a model
    predicts another kind of motion. Stretches of time are left out instead where logs
    are few, or where one log alone determines a direction and cannot be spared.

    Parameters
    ----------
    rows : BandRows
        M thinned samples of the equations, of all logs.
    fit : Fit
        The fit to all of them.

    Returns
    -------
    LeftOut
        Residuals (M, n) [N m], folds, and what was left out.
    """
    n_logs = int(rows.log.max()) + 1
    if n_logs >= FEWEST_LOGS:
        fold = rows.log * min(n_logs, MOST_FOLDS) // n_logs
        residual, largest_share = _without_folds(rows, fit, fold)
        if largest_share <= LARGEST_SHARE:
            return LeftOut(residual=residual, fold=fold, kind="logs")

    fold = _stretches(rows)
    residual, _ = _without_folds(rows, fit, fold)
    return LeftOut(residual=residual, fold=fold, kind="stretches")


def _stretches(rows: BandRows) -> Index:
    """Return the folds (M,) of samples: stretch k of every log is in fold k."""
    fold = np.zeros(rows.samples, dtype=np.intp)
    for log in np.unique(rows.log):
        in_log = np.flatnonzero(rows.log == log)
        fold[in_log] = np.arange(len(in_log)) * STRETCHES // len(in_log)
    return fold


def _without_folds(rows: BandRows, fit: Fit, fold: Index) -> tuple[Array, float]:
    """Leave out each fold once.

    Returns
    -------
    left_out : array (M, n)
        Residuals of the samples by the fit without their fold [N m].
    largest_share : float
        Largest share (mu) of the information on a direction that a fold holds.
    """
    fit_residual = rows.y - rows.H @ fit.theta
    predictors = fit.predictors
    residual = rows.y - rows.H[:, :, predictors] @ fit.theta[predictors]
    root = _root(fit.bread)
    left_out = residual.copy()
    largest_share = 0.0

    for number in np.unique(fold):
        in_fold = fold == number
        part = rows.part(in_fold)

        # Columns in units in which the whole fit's normal matrix is the identity.
        scale = np.sqrt(part.weight * fit.independent)[:, None] / fit.sigma
        scale = np.where(part.used, scale, 0.0)
        columns = ((part.H * scale[..., None]) @ root).reshape(-1, root.shape[1])
        score = columns.T @ (scale * fit_residual[in_fold]).ravel()

        share, directions = np.linalg.eigh(columns.T @ columns)
        largest_share = max(largest_share, float(share.max(initial=0.0)))
        # A larger share would divide by nearly nothing.
        share = np.clip(share, 0.0, LARGEST_SHARE)

        # theta - theta_F, and what this change adds to the residuals of the part.
        change = root @ (directions @ ((directions.T @ score) / (1.0 - share)))
        added_residual = part.H[:, :, predictors] @ change[predictors]
        left_out[in_fold] = residual[in_fold] + added_residual
    return left_out, largest_share


def _root(bread: Array, *, rounding: float = 1e-12) -> Array:
    """Return B (p, r) with B B' = bread; directions without variance are left out."""
    scale = np.sqrt(np.diag(bread))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(bread / np.outer(scale, scale))
    largest = max(float(values.max(initial=0.0)), 1e-300)
    has_variance = values > rounding * largest
    vectors = vectors[:, has_variance]
    values = values[has_variance]
    return np.asarray(scale[:, None] * vectors * np.sqrt(values))
