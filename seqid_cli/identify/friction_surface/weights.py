"""What the slices of a trial weigh: by their own noise, and little where they do not belong to it.

A joint is still speeding up, or slows already, in the first and last slices of some trials: their
torque is not friction alone. Slices are judged by Tukey's biweight (J. W. Tukey, in Beaton and
Tukey, Technometrics 16(2), 1974) of their distance from the surface, in units of the median
distance in their trial. Before there is a surface, medians stand in: of each trial over its
positions, of each position over the trials. What all trials have at one position is friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binned_statistic, median_abs_deviation

from seqid_cli.identify.friction_surface.reduction import SpeedData
from seqid_cli.typing import Array


def around_medians(data: Sequence[SpeedData], *, bins: int = 24) -> list[Array]:
    """Distances (K,) N m of slices from medians over positions and over trials."""
    middles = [item.friction - np.median(item.friction) for item in data]
    q, values = np.concatenate([item.q for item in data]), np.concatenate(middles)
    middle, edges, _ = binned_statistic(q, values, "median", bins)
    centres = 0.5 * (edges[1:] + edges[:-1])
    known = np.isfinite(middle)
    off = [
        own - np.interp(item.q, centres[known], middle[known])
        for item, own in zip(data, middles, strict=True)
    ]
    return [each - np.median(each) for each in off]


def weighted(
    data: Sequence[SpeedData], distances: Sequence[Array], *, min_scatter: float = 1e-9
) -> list[SpeedData]:
    """Weight the slices anew.

    `distances` (K,): of every slice from the surface, N m. `min_scatter`: of the usual friction,
    below which no scatter is believed. Returns: weights are samples of usual noise: fewer where a
    trial has more noise than the usual one, none where a slice does not belong to its trial.
    """
    level = float(np.median([np.median(np.abs(item.friction)) for item in data]))
    scales = np.array([max(_scale(own), min_scatter * level, 1e-300) for own in distances])
    variances = scales**2 * np.array([float(np.median(item.weight)) for item in data])
    usual = float(np.median(variances))
    return [
        replace(item, weight=item.weight * min(usual / variance, 1.0) * _biweight(own / scale))
        for item, own, scale, variance in zip(data, distances, scales, variances, strict=True)
    ]


def _scale(distances: Array) -> float:
    return float(median_abs_deviation(distances, scale="normal"))


def _biweight(ratio: Array, *, max_ratio: float = 4.685) -> Array:
    """Tukey's weights; 95 % efficient for normal errors."""
    return np.asarray(np.clip(1.0 - (ratio / max_ratio) ** 2, 0.0, None) ** 2)
