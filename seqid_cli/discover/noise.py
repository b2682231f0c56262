"""What is random in a log's torque and positions, as spectra: measured once, drawn often.

In the band, torque noise is what the residual shows, its low-pass undone; well above it, what the
raw torque shows, as the median over short stretches: that keeps out the steps of friction, which
reach above the cut-off as well. Between the two the model still explains most of the torque, so the
band's last value is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filtering import ORDER, Lowpass, runs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRETCH = 4.0  # periods of the cut-off over which the raw torque's spectrum is taken
ABOVE = 1.5  # cut-offs, from which the raw torque is taken for noise
SHORTEST_STRETCH = 16  # samples
SMOOTHING = 9  # bins of the spectrum that are averaged
LEAST_SHARE = 0.1  # of the residual's power that stays noise, whatever else explains
DETAIL = 0.002  # of a joint's torque, that no model gets right
LEAST_GAIN = 0.1  # of power, to which the low-pass is undone


def power_gain(lowpass: Lowpass, frequency: Array, times: int) -> Array:
    """Power gain of `times` zero-phase passes at frequencies (F,) Hz."""
    if not lowpass.active:
        return np.ones_like(frequency)
    rate = lowpass.rate_hz
    warped = np.tan(np.pi * np.minimum(frequency, 0.499999 * rate) / rate)
    ratio = warped / np.tan(np.pi * lowpass.cutoff_hz / rate)
    gain: Array = (1.0 + ratio ** (2 * ORDER)) ** (-2.0 * times)
    return gain


def median_spectrum(values: Array, starts: Sequence[int], length: int, rate_hz: float) -> Array:
    """Two-sided density (length // 2 + 1,) of values (N,): the median over stretches.

    Parameters
    ----------
    values : (N,) array
    starts : sequence of int
        First samples of the stretches of `length` samples, each tapered, its trend removed.
    length : int
    rate_hz : float
    """
    window = np.hanning(length)
    pieces = np.stack([detrend(values[s : s + length]) for s in starts])
    power = np.abs(np.fft.rfft(window * pieces, axis=1)) ** 2 / (rate_hz * np.sum(window**2))
    if len(starts) < 3:
        return np.asarray(power.mean(axis=0))
    # The median of an exponential distribution is log 2 of its mean.
    return np.asarray(np.median(power, axis=0) / np.log(2.0))


def stretches(mask: Mask, length: int) -> list[int]:
    """First samples of as many stretches of `length` samples as lie within True."""
    return [s for a, b in runs(mask, len(mask)) for s in range(a, b - length + 1, length)]


@dataclass(frozen=True)
class TorqueNoise:
    """Two-sided density (F, n) of a log's torque noise on the frequencies of its N samples."""

    density: Array
    samples: int
    rate_hz: float

    def draw(self, rng: np.random.Generator) -> Array:
        """Gaussian noise (N, n) N m of this spectrum."""
        size = np.sqrt(0.5 * self.density * self.rate_hz * self.samples)
        shape = self.density.shape
        wave = size * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        noise: Array = np.fft.irfft(wave, n=self.samples, axis=0)
        return noise


def torque_noise(recording: Recording, scene: Scene, residual: Array, echo: Array) -> TorqueNoise:
    """Measure a log's torque noise.

    Parameters
    ----------
    recording : Recording
        With torque.
    scene : Scene
        Of the same log.
    residual : (N, n) array
        Low-passed residual at the scene's samples, N m; zero where it does not count.
    echo : (N, n) array
        What drawn logs show of such a residual without torque noise (the encoder's noise, motion
        that the low-pass lost, joints that stick): taken off the spectrum.
    """
    assert recording.tau is not None
    samples, rate = len(recording.t), recording.rate_hz
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    cutoff = scene.motion.lowpass.cutoff_hz
    length = min(max(SHORTEST_STRETCH, round(STRETCH * rate / cutoff)), samples)
    moving = nearest(scene.motion.moving, samples) & recording.valid[:, None]
    own, shown = in_band(scene, residual, echo)
    density = np.zeros((len(frequency), moving.shape[1]))
    for j, noise in enumerate(density.T):
        starts = stretches(moving[:, j], length) or stretches(recording.valid, length) or [0]
        raw = median_spectrum(recording.tau[:, j], starts, length, rate)
        noise[:] = np.interp(frequency, np.fft.rfftfreq(length, 1.0 / rate), raw)
        if residual[:, j].any():
            band = frequency <= ABOVE * cutoff
            noise[band] = np.interp(frequency[band], own, shown[:, j])
    return TorqueNoise(density, samples, rate)


def in_band(scene: Scene, residual: Array, echo: Array) -> tuple[Array, Array]:
    """Frequencies (K,) Hz up to the cut-off, two-sided density (K, n) without the low-pass."""
    motion = scene.motion
    frequency: Array = np.fft.rfftfreq(motion.samples, 1.0 / motion.rate_hz).astype(np.float64)
    gain = power_gain(motion.lowpass, frequency, 2)
    inside = gain >= LEAST_GAIN
    counted = np.maximum(np.count_nonzero(residual, axis=0), 1)
    whole, brought = periodogram(residual), periodogram(np.where(residual != 0, echo, 0.0))
    density = np.maximum(whole - brought, LEAST_SHARE * whole) / (motion.rate_hz * counted)
    return frequency[inside], density[inside] / gain[inside, None]


def periodogram(values: Array) -> Array:
    """Squared spectrum (F, n) of values (N, n), averaged over neighbouring frequencies.

    Over fewer at the lowest ones, where drifts fall off by factors from one to the next.
    """
    square = np.abs(np.fft.rfft(values, axis=0)) ** 2
    count = len(square)
    at = np.arange(count)
    reach = np.minimum(np.minimum(SMOOTHING // 2, at // 2), count - 1 - at)
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(square, axis=0)])
    smooth: Array = (sums[at + reach + 1] - sums[at - reach]) / (2 * reach + 1)[:, None]
    return np.maximum(smooth, 0.0)


def nearest(mask: Mask, samples: int) -> Mask:
    """A mask (M, n) of a scene at the log's own `samples`."""
    at = np.linspace(0, len(mask) - 1, samples).round().astype(int)
    spread: Mask = mask[at]
    return spread
