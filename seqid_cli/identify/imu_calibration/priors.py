"""Priors of the IMU calibration: how wide they are, and what holds a frame that nothing shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.identify.imu_calibration.sensor_model import Constants, channels_of, tangents
from seqid_cli.motion.imu.array import layout
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array

TURN, LEVER, DELAY = np.pi, 1.0, 0.3  # widest priors: rad, m, s
BIAS = 3.0  # m/s^2 or rad/s
FIRST_GAIN, FIRST_TILT, FIRST_DRIFT = 0.02, 0.01, 0.02
LEAST_WIDTH = 1e-4
FEW = 6  # accelerometers below which the widths stay as they begin
GAUGE = 1e-6  # rad


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the priors on gains, tilts (rad) and bias changes, per channel."""

    gain: Array
    tilt: Array
    drift: Array


def first_widths(count: int) -> Widths:
    """Widths to begin with."""
    full = np.ones(count)
    return Widths(FIRST_GAIN * full, FIRST_TILT * full, FIRST_DRIFT * full)


def prior_of(widths: Widths) -> Array:
    """Prior standard deviations (p,) of the constants."""
    count = len(widths.gain)
    return np.concatenate(
        [
            np.full(3, TURN),
            np.full(3, LEVER),
            [DELAY],
            np.full(count, BIAS),
            widths.gain,
            np.repeat(widths.tilt, 2),
        ]
    )


def values_of(constants: Constants) -> Array:
    """Constants as a vector (p,), the rotation's part zero."""
    return np.concatenate(
        [
            np.zeros(3),
            constants.lever,
            [constants.delay],
            constants.bias,
            constants.log_gain,
            constants.tilt.ravel(),
        ]
    )


def own_precision(segment: Segment, widths: Widths) -> Array:
    """Precision of the priors on a segment's bias changes and offsets."""
    return np.concatenate([widths.drift, segment.offset_sigma]) ** -2.0


def gauge_information(imu: Imu, count: int, p: int) -> Array:
    """Hold the accelerometers' common turn where only the mounting shows it."""
    out = np.zeros((p, p))
    if layout(imu).acceleration:
        return out
    axes, _, k = channels_of(imu)
    across = tangents(axes[:k])
    rows = np.zeros((3, p))
    for a in range(2):
        turns = np.cross(axes[:k], across[:, a])
        rows[:, 7 + 2 * count + a : 7 + 2 * count + 2 * k : 2] = turns.T / k
    return rows.T @ rows / GAUGE**2


def next_width(values: Array, left_open: Array, width: Array) -> float:
    """Next standard deviation of a prior that `values` come from (MacKay's fixed point)."""
    known = np.maximum(1.0 - left_open / width**2, 0.0)
    found = float(np.sqrt(np.sum(values**2) / max(float(np.sum(known)), 1.0)))
    largest = float(np.max(width))
    return float(np.clip(found, max(LEAST_WIDTH, largest / 5.0), largest * 5.0))
