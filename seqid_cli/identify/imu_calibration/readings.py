"""Readings of an IMU for its calibration: cleaned of spikes and saturation, then low-passed."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import binary_dilation, median_filter

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.smoother.encoder import bridged
from seqid_cli.robot.types import Imu
from seqid_cli.robust import DIFFERENCES, gaussian_spread, rough, white_noise
from seqid_cli.typing import Array, Index, Mask


@dataclass(frozen=True)
class Readings:
    """Low-passed readings (N0, C) at the log's own rate, to be read at any time."""

    t: Array
    values: Array
    good: Mask  # (N0, C)
    noise: Array  # (C,) standard deviation of one raw sample
    rough: Array  # (N0, C) of raw readings near the Nyquist rate, NaN where not known
    curve: BSpline

    @property
    def jolts(self) -> float:
        """Variance, of all channels together, of what is rough beyond white noise.

        Jolts faster than the log's rate alias: samples no longer add up to the motion between them.
        """
        known = self.rough[np.isfinite(self.rough).all(axis=1)]
        if not len(known):
            return 0.0
        excess = np.mean(known**2, axis=0) - gaussian_spread(known) ** 2
        return float(np.sum(np.maximum(excess, 0.0)))

    @property
    def period(self) -> float:
        """Time between samples [s]."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    def at(self, t: Array) -> tuple[Array, Mask]:
        """Readings (N, C) and whether they count, at times `t` [s] of their own stamps."""
        inside = (t >= self.t[0]) & (t <= self.t[-1])
        values = self.curve(np.clip(t, self.t[0], self.t[-1]))
        return np.asarray(values), self.good[self._near(t)] & inside[:, None]

    def rough_at(self, t: Array) -> Array:
        """Roughness (N, C) of the raw samples next to times `t` [s], NaN where not known."""
        return np.asarray(self.rough[self._near(t)])

    def _near(self, t: Array) -> Index:
        return np.clip(np.searchsorted(self.t, t - 0.5 * self.period), 0, len(self.t) - 1)


def readings_of(recording: Recording, imu: Imu, lowpass: Lowpass) -> Readings:
    """Clean and low-pass one log's channels of an IMU, accelerometers first."""
    raw = recording.accelerometers.get(imu.name, np.zeros((len(recording.t), 0)))
    if imu.gyro and imu.name in recording.gyros:
        raw = np.hstack([raw, recording.gyros[imu.name]])
    values, bad = cleaned(raw, recording.valid)
    reach = max(1, round(0.4 * recording.rate_hz / lowpass.cutoff_hz))
    spread = binary_dilation(bad, np.ones((2 * reach + 1, 1), dtype=bool))
    smooth = lowpass(values, recording.valid)
    curve = make_interp_spline(recording.t, smooth, k=3)
    # Jolts are in most channels at once; what jumps in one by itself is bridged.
    together = (bad.mean(axis=1) > 0.5)[:, None] & np.isfinite(raw)
    own = roughness(np.where(together, raw, values), recording.valid)
    return Readings(recording.t, smooth, ~spread, white_noise(values), own, curve)


def roughness(values: Array, valid: Mask) -> Array:
    """Noise and jolts of raw readings (N, C) without the motion, as large as in the readings."""
    out = np.full(values.shape, np.nan)
    if len(values) > DIFFERENCES:
        half = DIFFERENCES // 2
        whole = np.lib.stride_tricks.sliding_window_view(valid, DIFFERENCES + 1).all(axis=1)
        out[half:-half] = np.where(np.asarray(whole)[:, None], rough(values), np.nan)
    return out


def cleaned(values: Array, valid: Mask, *, min_spike: float = 8.0) -> tuple[Array, Mask]:
    """Readings (N, C) with spikes, saturation and missing values bridged, and where they were.

    A spike stands out of the median of its neighbours by `min_spike` times the noise.
    """
    finite = np.isfinite(values)
    values = np.where(finite, values, 0.0)
    bad = ~finite | ~valid[:, None]
    middle = median_filter(values, size=(5, 1), mode="nearest")
    off = np.abs(values - middle)
    motion = np.abs(np.gradient(middle, axis=0)) if len(values) > 1 else off
    noise = np.maximum(white_noise(values), 1e-9)
    bad |= off > min_spike * noise + 4.0 * motion
    bad |= _saturated(values, noise)
    whole = bad.all(axis=0)  # nothing to bridge it with
    mended = [bridged(v, ~b) for v, b in zip(values.T, (bad & ~whole).T, strict=True)]
    return np.column_stack(mended), bad


def _saturated(values: Array, noise: Array, *, min_run: int = 4) -> Mask:
    """Runs of at least `min_run` equal extreme readings, in a channel that otherwise is noisy."""
    result = np.zeros(values.shape, dtype=bool)
    for c, channel in enumerate(values.T):
        # A coarse but honest channel also repeats itself, by chance: not for long.
        shortest = min_run if noise[c] > 1e-9 else 10 * min_run
        for extreme in (channel.max(), channel.min()):
            for start, stop in runs(channel == extreme, len(channel)):
                if stop - start >= shortest and np.ptp(channel) > 100 * noise[c]:
                    result[start:stop, c] = True
    return result
