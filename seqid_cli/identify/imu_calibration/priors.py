"""Priors of the IMU calibration: how wide they are, and what holds a frame that nothing shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.identify.imu_calibration.sensor_model import Constants, channels_of, tangents
from seqid_cli.motion.imu.array import layout
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array

FEW = 6  # accelerometers below which the widths stay as they begin


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the priors on gains, tilts (rad) and bias changes, per channel."""

    gain: Array
    tilt: Array
    drift: Array


def first_widths(
    count: int, *, gain: float = 0.02, tilt: float = 0.01, drift: float = 0.02
) -> Widths:
    """Widths to begin with."""
    return Widths(*(np.full(count, width) for width in (gain, tilt, drift)))


def prior_of(widths: Widths, *, lever: float = 1.0, delay: float = 0.3, bias: float = 3.0) -> Array:
    """Prior standard deviations (p,) of the constants; m, s, and m/s^2 or rad/s."""
    wide = np.full(len(widths.gain), bias), widths.gain, np.repeat(widths.tilt, 2)
    return np.concatenate([[np.pi] * 3, [lever] * 3, [delay], *wide])


def values_of(c: Constants) -> Array:
    """Constants as a vector (p,), the rotation's part zero."""
    return np.concatenate([np.zeros(3), c.lever, [c.delay], c.bias, c.log_gain, c.tilt.ravel()])


def own_precision(segment: Segment, widths: Widths) -> Array:
    """Precision of the priors on a segment's bias changes and offsets."""
    return np.concatenate([widths.drift, segment.offset_sigma]) ** -2.0


def gauge_information(imu: Imu, count: int, p: int, *, hold: float = 1e-6) -> Array:
    """Hold the accelerometers' common turn, to so many rad, where only the mounting shows it."""
    if layout(imu).acceleration:
        return np.zeros((p, p))
    axes, _, k = channels_of(imu)
    across = tangents(axes[:k])
    rows = np.zeros((3, p))
    for a in range(2):
        turns = np.cross(axes[:k], across[:, a])
        rows[:, 7 + 2 * count + a : 7 + 2 * count + 2 * k : 2] = turns.T / k
    return rows.T @ rows / hold**2


def next_width(
    values: Array, left_open: Array, width: Array, *, least: float = 1e-4, most_change: float = 5.0
) -> float:
    """Next standard deviation of a prior that `values` come from (MacKay's fixed point)."""
    known = np.maximum(1.0 - left_open / width**2, 0.0)
    found = float(np.sqrt(np.sum(values**2) / max(float(np.sum(known)), 1.0)))
    largest = float(np.max(width))
    return float(np.clip(found, max(least, largest / most_change), largest * most_change))
