"""What the choice of a cut-off needs to know of a log, gathered block by block.

Welch spectra are means over segments, counted from the first sample on, and add up as
the samples come; which joints move follows from the largest travel over each time
scale; an encoder's step from the levels it was seen at. A short log is one block.
"""

import weakref
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.fft import rfft
from scipy.signal import get_window

from seqid_cli.logs.long import Thinned
from seqid_cli.motion.filters import bandwidth
from seqid_cli.motion.segmentation import SCALES_S, SHAKEN, SMALLEST_STEP, TRAVEL_STEPS
from seqid_cli.robust import DIFFERENCES_GAIN, PER_MEDIAN
from seqid_cli.typing import Array, Index, Mask

MOST_LEVELS = 65_536  # distinct positions of a joint; a step and noise show in fewer
MANY = 1 << 60


class Welch:
    """One-sided spectral density of c signals, by Welch's method with half overlap.

    Equal to `scipy.signal.welch` (Hann window, no detrending) of the signals as a
    whole, as long as they have no more than `dense` samples. Behind those every
    `sparse`-th segment is taken.
    """

    def __init__(self, length: int, differences: int = 0) -> None:
        self.length = length
        self._differences = differences  # that are taken of the samples first
        self._window = get_window("hann", length)
        self._sum: Array | float = 0.0
        self._segments = self._start = 0  # taken so far; where the next one begins

    def look(
        self, samples: Array, begin: int, *, dense: int = 262144, sparse: int = 4
    ) -> int:
        """Take what is new in samples from number `begin` on; tells which is wanted next."""
        hop, wanted = self.length - self.length // 2, self.length + self._differences
        while self._start + wanted <= begin + len(samples):
            start = self._start - begin
            piece = samples[start : start + wanted].T
            if self._differences:
                piece = np.diff(piece, self._differences, axis=1)
            spectrum = rfft(piece * self._window, axis=1, overwrite_x=True)
            self._sum = self._sum + (spectrum.real**2 + spectrum.imag**2)
            self._segments += 1
            self._start += hop if self._start < dense else sparse * hop
        return self._start

    def density(self, rate_hz: float) -> tuple[Array, Array]:
        """Return frequencies (F,) Hz and densities (c, F) of samples at a rate."""
        assert self._segments
        density = np.asarray(
            self._sum / (rate_hz * np.sum(self._window**2) * self._segments)
        )
        density[:, 1 : None if self.length % 2 else -1] *= 2
        frequency = np.arange(self.length // 2 + 1) * (rate_hz / self.length)
        return np.asarray(frequency, dtype=np.float64), density


class Survey:
    """Takes a log's positions (M, n) in order; then tells the noise step and the cut-off."""

    def __init__(self, n: int, rate_hz: float, samples: int = MANY) -> None:
        self.rate_hz = rate_hz
        self._levels: list[Array] = [np.zeros(0) for _ in range(n)]
        self._fourth = Thinned(MOST_LEVELS)
        second, velocity, self._halves = _lengths(rate_hz, samples)
        self._second, self._velocity = Welch(second, 2), Welch(velocity, 1)
        self._travel = np.zeros(n)
        self._seen = 0
        self._tail: Array | None = None

    @classmethod
    def of(cls, q: Array, rate_hz: float) -> "Survey":
        """Look at all positions (N, n) of a log."""
        survey = cls(q.shape[1], rate_hz, len(q))
        survey.push(q)
        return survey

    def push(self, q: Array, *, steps: int = 16) -> None:
        """Take the next samples; travel is looked at `steps` times in half a reach of motion."""
        for j, levels in enumerate(self._levels):
            if len(levels) <= MOST_LEVELS:
                values = np.round(q[:, j], 10)
                values = values[np.diff(values, prepend=np.nan) != 0]
                self._levels[j] = np.unique(np.concatenate([levels, values]))
        wide = q if self._tail is None else np.concatenate([self._tail, q])
        end = self._seen + len(q)
        begin = end - len(wide)
        self._fourth.push(
            np.abs(np.diff(wide[max(0, self._seen - begin - 4) :], 4, axis=0))
        )
        wanted = [
            spectrum.look(wide, begin) for spectrum in (self._second, self._velocity)
        ]
        for half in self._halves:
            low, step = max(0, self._seen - begin - 2 * half), max(1, half // steps)
            # on the same samples whatever parts they come in
            low += -(begin + low) % step
            if low + 2 * half < len(wide):
                travel = np.abs(
                    wide[low + 2 * half :: step] - wide[low : -2 * half : step]
                )
                largest = travel.max(axis=1, keepdims=True)
                own = np.where(travel > SHAKEN * largest, travel, 0.0).max(axis=0)
                self._travel = np.maximum(self._travel, own)
        keep = min([*wanted, end - 2 * max([*self._halves, 2])])
        self._tail = wide[max(0, keep - begin) :].copy(order="K")
        self._seen = end

    def at_rate(self, rate_hz: float, samples: int) -> bool:
        """Take the rate and the number of samples that came; False if others would be needed."""
        before = (self._second.length, self._velocity.length, self._halves)
        self.rate_hz = rate_hz
        return before == _lengths(rate_hz, samples)

    def encoder_step(self) -> Array:
        """Smallest step of each joint's position (n,) rad, 0 where it is not quantised."""
        return np.array([bandwidth.step_of(levels) for levels in self._levels])

    def count(self, resolution: Array) -> Array:
        """Step of each encoder (n,) rad: that of the robot file, else that of the positions."""
        return np.where(resolution > 0, resolution, self.encoder_step())

    def noise_step(self, resolution: Array) -> Array:
        """As `segmentation.noise_step`."""
        step = np.maximum(self.encoder_step(), resolution)
        least = np.maximum(step, SMALLEST_STEP)
        if not (step > 0).all():
            noise = PER_MEDIAN / DIFFERENCES_GAIN * np.median(self._fourth.rows, axis=0)
            least = np.maximum(least, np.where(step > 0, 0.0, 3 * noise))
        return least

    def moving(self, step: Array) -> Mask:
        """Joints (n,) that move at any time."""
        return np.asarray(self._travel > TRAVEL_STEPS * step)

    def cutoff(
        self, resolution: Array, *, highest_hz: float = bandwidth.HIGHEST_HZ
    ) -> bandwidth.Cutoff:
        """Choose one low-pass cut-off by the joints that move; the others say nothing about it."""
        # `resolution` (n,) rad: of the robot file, zero where the step is to be read
        # off the data.
        step, joints = self._steps(resolution)
        highest = min(highest_hz, self.rate_hz / 8)
        floors = step**2 / 12 * 2 / self.rate_hz
        if len(joints):
            widest = self._widest(joints, step)
            seconds = self._seen / self.rate_hz
            highest = min(highest, bandwidth.highest_of(widest, len(joints), seconds))
        candidates = np.geomspace(min(bandwidth.LOWEST_HZ, highest / 2), highest, 120)
        best = len(candidates) // 2  # where nothing moves
        if len(joints):
            score, floors[joints] = self._scored(joints, step, candidates)
            best = bandwidth.first_maximum(score)
        return bandwidth.Cutoff(float(candidates[best]), step, floors)

    def score(self, resolution: Array, cutoffs: Array) -> bandwidth.Score | None:
        """Score cut-offs (C,) Hz by the joints that move; None where none does."""
        step, joints = self._steps(resolution)
        if not len(joints):
            return None
        below = np.minimum(cutoffs, self.rate_hz / 2)
        values, floors = self._scored(joints, step, below)
        seconds = self._seen / self.rate_hz
        return bandwidth.Score(
            values=values,
            bandwidth_hz=self._widest(joints, step),
            joints=len(joints),
            seconds=seconds,
            shares=self._shares(joints, floors, below, seconds),
        )

    def _shares(
        self, joints: Index, floors: Array, cutoffs: Array, seconds: float
    ) -> bandwidth.NoiseShares:
        """Return how much of the joints' motion is noise; `floors` as `_scored` returns them."""
        frequency, density = self._acceleration()
        moves = np.zeros((len(density), 1))
        moves[joints] = 1.0
        noise = np.zeros(len(density))
        noise[joints] = floors
        error = np.array(
            [bandwidth.differentiated_error(noise, hz) for hz in cutoffs]
        ).T
        return bandwidth.noise_shares(
            frequency, moves * density, error, cutoffs, seconds
        )

    def _acceleration(self) -> tuple[Array, Array]:
        """Return frequencies (F,) [Hz] and densities (n, F) of the acceleration."""
        # Spectra of the second difference of the position: it whitens the steep
        # spectrum of the position before the window smears it.
        rate = self.rate_hz
        frequency, density = self._second.density(rate)
        density *= rate**4
        density /= np.maximum(np.sinc(frequency / rate) ** 4, 0.05)
        return frequency, density

    def _steps(self, resolution: Array) -> tuple[Array, Index]:
        """Encoder steps (n,) rad and the joints that move."""
        return self.count(resolution), np.flatnonzero(
            self.moving(self.noise_step(resolution))
        )

    def _widest(self, joints: Index, step: Array) -> float:
        """Return the bandwidth of the motion [Hz], the largest of some joints.

        `step` (n,): steps of the encoders [rad].
        """
        rate = self.rate_hz
        frequency, density = self._velocity.density(rate)
        density *= rate**2
        return max(
            bandwidth.bandwidth_of(frequency, density[j], rate, step=float(step[j]))
            for j in joints
        )

    def _scored(
        self, joints: Index, step: Array, cutoffs: Array
    ) -> tuple[Array, Array]:
        """Score of each cut-off (C,) by some joints, and these joints' noise densities."""
        rate = self.rate_hz
        frequency, density = self._acceleration()
        top = (frequency > 0.2 * rate) & (frequency < 0.4 * rate)
        score, floors = np.zeros(len(cutoffs)), np.zeros(len(joints))
        for k, j in enumerate(joints):
            # The position's noise: the quantisation's, or what the top of the spectrum
            # shows.
            above = density[j, top] / (2 * np.pi * frequency[top]) ** 4
            shown = float(np.median(above)) if top.any() else 0.0
            floors[k] = max(step[j] ** 2 / 12 * 2 / rate, shown, 1e-30)
            noise = bandwidth.differentiated_error(floors[k], cutoffs)
            signal = bandwidth.power_below(frequency, density[j], cutoffs) - noise
            # Power beyond the first point where noise takes over is noise, whatever its
            # level.
            signal = np.maximum.accumulate(np.maximum(signal, 1e-12))
            score += np.log(signal) - bandwidth.KAPPA * noise / signal
        return score, floors


def survey_of_positions(q: Array, rate_hz: float) -> Survey:
    """Return the survey of positions (N, n) that are held; made once while the array lives.

    A log is filtered at several cut-offs, and what they are chosen from is the same for
    all.
    """
    number = id(q)
    known = _KEPT.get(number)
    if known is not None and known.q() is q and known.survey.rate_hz == rate_hz:
        return known.survey
    survey = Survey.of(q, rate_hz)
    forget = partial(_KEPT.pop, number, None)
    _KEPT[number] = _Kept(weakref.ref(q, lambda _: forget()), survey)
    return survey


@dataclass(frozen=True)
class _Kept:
    """A survey and the positions that it is of."""

    q: weakref.ref[Array]
    survey: Survey


_KEPT: dict[int, _Kept] = {}


def _lengths(
    hz: float,
    samples: int,
    *,
    second_s: int = 8,
    velocity_s: int = 20,
    least_segment: int = 256,
) -> tuple[int, int, list[int]]:
    """Segments of both spectra and halves of the time scales, in samples."""
    second, velocity = (max(least_segment, int(s * hz)) for s in (second_s, velocity_s))
    halves = [max(1, round(scale * hz / 2)) for scale in SCALES_S]
    halves = [half for half in halves if 2 * half < samples]
    return min(samples - 2, second), min(samples - 1, velocity), halves
