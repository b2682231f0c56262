"""What the choice of a cut-off needs to know of a log, gathered block by block.

Welch spectra are means over segments, counted from the first sample on, and add up as
the samples come; which joints move follows from the largest travel over each time
scale; an encoder's step from the levels it was seen at. A short log is one block.
"""

import weakref
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.fft import rfft

from seqid_cli.errors import InputError
from seqid_cli.logs.thinned import Thinned
from seqid_cli.motion.filters import bandwidth
from seqid_cli.motion.segmentation import SCALES_S, SHAKEN, SMALLEST_STEP, TRAVEL_STEPS
from seqid_cli.robust import DIFFERENCES_GAIN, PER_MEDIAN
from seqid_cli.spectra import hann
from seqid_cli.typing import Array, Index, Mask

MOST_LEVELS = 65_536  # distinct positions of a joint; a step and noise show in fewer


class Welch:
    """One-sided spectral density of c signals, by Welch's method with half overlap.

    Equal to `scipy.signal.welch` (Hann window, no detrending) of the signals as a
    whole, as long as they have no more than `dense` samples. Behind those every
    `sparse`-th segment is taken.
    """

    def __init__(self, length: int, differences: int = 0) -> None:
        self.length = length
        self._differences = differences  # that are taken of the samples first
        self._window = hann(length)
        self._sum: Array | float = 0.0
        self._segments = 0  # taken so far
        self._start = 0  # where the next segment begins

    def look(
        self, samples: Array, begin: int, *, dense: int = 262144, sparse: int = 4
    ) -> int:
        """Take the segments that end within some samples.

        Parameters
        ----------
        samples : Array
            (M, c), consecutive; those that were seen before are passed over.
        begin : int
            Number of the first of them.
        dense : int
            Samples up to which every segment is taken.
        sparse : int
            Behind those every `sparse`-th segment is taken.

        Returns
        -------
        int
            Number of the first sample that the next segment needs.
        """
        hop = self.length - self.length // 2
        wanted = self.length + self._differences
        while self._start + wanted <= begin + len(samples):
            start = self._start - begin
            piece = samples[start : start + wanted].T
            if self._differences:
                piece = np.diff(piece, self._differences, axis=1)
            spectrum = rfft(piece * self._window, axis=1)
            self._sum = self._sum + (spectrum.real**2 + spectrum.imag**2)
            self._segments += 1
            self._start += hop if self._start < dense else sparse * hop
        return self._start

    def density(self, rate_hz: float) -> tuple[Array, Array]:
        """Return frequencies (F,) Hz and densities (c, F) of samples at a rate."""
        assert self._segments
        window_power = np.sum(self._window**2)
        density = np.asarray(self._sum / (rate_hz * window_power * self._segments))
        # Negative frequencies count with the positive ones; zero and, of an even
        # length, the Nyquist frequency have none.
        density[:, 1 : None if self.length % 2 else -1] *= 2
        frequency = np.arange(self.length // 2 + 1) * (rate_hz / self.length)
        return np.asarray(frequency, dtype=np.float64), density


class Survey:
    """What is known of a log's positions: noise step, motion, the cut-off that suits.

    Positions (M, n) rad are pushed in order, in parts of any length.
    """

    def __init__(self, n: int, rate_hz: float, samples: int) -> None:
        self.rate_hz = rate_hz
        self._levels: list[Array] = [np.zeros(0) for _ in range(n)]
        self._is_continuous = np.zeros(n, dtype=np.bool_)
        self._encoder_step: Array | None = None
        self._fourth = Thinned(MOST_LEVELS)
        lengths = _lengths(rate_hz, samples)
        if lengths.second < 1:
            raise InputError(
                f"{samples} samples are too few to be filtered",
                hint="Record longer, or look at the unit of time (seqid inspect LOG).",
            )
        self._halves = lengths.halves
        self._second = Welch(lengths.second, 2)
        self._velocity = Welch(lengths.velocity, 1)
        self._travel = np.zeros(n)  # largest within a time scale
        self._seen = 0  # samples so far
        self._tail: Array | None = None  # samples that are needed again

    @classmethod
    def of(cls, q: Array, rate_hz: float) -> "Survey":
        """Look at all positions (N, n) of a log."""
        survey = cls(q.shape[1], rate_hz, len(q))
        survey.push(q)
        return survey

    def push(self, q: Array, *, steps: int = 16) -> None:
        """Take the next samples q (M, n) rad.

        Travel is looked at `steps` times in half a time scale.
        """
        self._encoder_step = None
        for j, levels in enumerate(self._levels):
            if len(levels) > MOST_LEVELS or self._is_continuous[j]:
                continue
            self._is_continuous[j] = bandwidth.is_continuous(q[:, j])
            if not self._is_continuous[j]:
                values = np.round(q[:, j], 10)
                values = values[np.diff(values, prepend=np.nan) != 0]
                self._levels[j] = np.unique(np.concatenate([levels, values]))

        # Samples `begin` to `end`: the new ones behind those that are needed again.
        wide = q if self._tail is None else np.concatenate([self._tail, q])
        end = self._seen + len(q)
        begin = end - len(wide)
        n_old = self._seen - begin
        differences = np.diff(wide[max(0, n_old - 4) :], 4, axis=0)
        self._fourth.push(np.abs(differences))
        wanted_next = [
            self._second.look(wide, begin),
            self._velocity.look(wide, begin),
        ]
        for half in self._halves:
            self._look_at_travel(wide, begin, n_old, half, max(1, half // steps))

        longest_half = max([*self._halves, 2])
        first_needed = min([*wanted_next, end - 2 * longest_half])
        self._tail = wide[max(0, first_needed - begin) :].copy(order="K")
        self._seen = end

    def _look_at_travel(
        self, wide: Array, begin: int, n_old: int, half: int, stride: int
    ) -> None:
        """Take the largest travel over 2 `half` samples, at every `stride`-th of them.

        `wide` (M, n) are samples from number `begin` on, of which `n_old` were looked
        at before.
        """
        low = max(0, n_old - 2 * half)
        # On the same samples whatever parts they come in.
        low += -(begin + low) % stride
        if low + 2 * half >= len(wide):
            return
        travel = np.abs(wide[low + 2 * half :: stride] - wide[low : -2 * half : stride])
        largest = travel.max(axis=1, keepdims=True)
        # A joint that the fastest one shakes does not move.
        of_movers = np.where(travel > SHAKEN * largest, travel, 0.0)
        self._travel = np.maximum(self._travel, of_movers.max(axis=0))

    def encoder_step(self) -> Array:
        """Return the smallest steps (n,) rad of positions; zero if not quantised."""
        if self._encoder_step is None:
            steps = [bandwidth.step_between(levels) for levels in self._levels]
            self._encoder_step = np.where(self._is_continuous, 0.0, steps)
        return self._encoder_step

    def count(self, resolution: Array) -> Array:
        """Return the encoder steps (n,) rad of the robot file, or else of positions."""
        return np.where(resolution > 0, resolution, self.encoder_step())

    def noise_step(self, resolution: Array) -> Array:
        """Return the same (n,) rad as `segmentation.noise_step`."""
        step = np.maximum(self.encoder_step(), resolution)
        is_quantised = step > 0
        noise_step = np.maximum(step, SMALLEST_STEP)
        if not is_quantised.all():
            noise = PER_MEDIAN / DIFFERENCES_GAIN * np.median(self._fourth.rows, axis=0)
            of_noise = np.where(is_quantised, 0.0, 3 * noise)
            noise_step = np.maximum(noise_step, of_noise)
        return noise_step

    def moving(self, step: Array) -> Mask:
        """Return the joints (n,) that move at any time, for noise steps (n,) rad."""
        return np.asarray(self._travel > TRAVEL_STEPS * step)

    def cutoff(
        self, resolution: Array, *, highest_hz: float = bandwidth.HIGHEST_HZ
    ) -> bandwidth.Cutoff:
        """Choose one low-pass cut-off by the joints that move.

        Parameters
        ----------
        resolution : Array
            (n,) rad, encoder steps of the robot file; zero where the step is to be read
            off the data.
        highest_hz : float
            Bound of the cut-off.
        """
        step, joints = self._steps(resolution)
        highest = min(highest_hz, self.rate_hz / 8)
        density = _quantisation_density(step, self.rate_hz)
        if not len(joints):
            # Nothing tells: the middle of the candidates.
            candidates = _candidates(highest)
            middle = float(candidates[len(candidates) // 2])
            return bandwidth.Cutoff(middle, step, density)

        seconds = self._seen / self.rate_hz
        widest = self._widest(joints, step)
        highest = min(highest, bandwidth.highest_of(widest, len(joints), seconds))
        candidates = _candidates(highest)
        scored = self._scored(joints, step, candidates)
        density[joints] = scored.noise_density
        best = bandwidth.first_maximum(scored.values)
        return bandwidth.Cutoff(float(candidates[best]), step, density)

    def score(self, resolution: Array, cutoffs: Array) -> bandwidth.Score | None:
        """Score cut-offs (C,) Hz by the joints that move; None where none does."""
        step, joints = self._steps(resolution)
        if not len(joints):
            return None
        below = np.minimum(cutoffs, self.rate_hz / 2)
        scored = self._scored(joints, step, below)
        seconds = self._seen / self.rate_hz
        return bandwidth.Score(
            values=scored.values,
            bandwidth_hz=self._widest(joints, step),
            joints=len(joints),
            seconds=seconds,
            shares=self._shares(joints, scored.noise_density, below, seconds),
        )

    def _shares(
        self, joints: Index, noise_density: Array, cutoffs: Array, seconds: float
    ) -> bandwidth.NoiseShares:
        """Return how much of the joints' motion is noise below cut-offs (C,) Hz.

        `noise_density` (len(joints),) rad^2/Hz is of their positions.
        """
        frequency, density = self._acceleration()
        moves = np.zeros((len(density), 1))
        moves[joints] = 1.0
        noise = np.zeros(len(density))
        noise[joints] = noise_density
        errors = [bandwidth.differentiated_error(noise, hz) for hz in cutoffs]
        return bandwidth.noise_shares(
            frequency, moves * density, np.array(errors).T, cutoffs, seconds
        )

    def _acceleration(self) -> tuple[Array, Array]:
        """Return frequencies (F,) Hz and densities (n, F) of the acceleration."""
        # Spectra of the second difference of the position: it whitens the steep
        # spectrum of the position before the window smears it.
        rate_hz = self.rate_hz
        frequency, density = self._second.density(rate_hz)
        density *= rate_hz**4
        density /= np.maximum(np.sinc(frequency / rate_hz) ** 4, 0.05)
        return frequency, density

    def _steps(self, resolution: Array) -> tuple[Array, Index]:
        """Return the encoder steps (n,) rad and the joints that move."""
        moving = self.moving(self.noise_step(resolution))
        return self.count(resolution), np.flatnonzero(moving)

    def _widest(self, joints: Index, step: Array) -> float:
        """Return the bandwidth of the motion [Hz], the largest of some joints.

        `step` (n,): steps of the encoders [rad].
        """
        rate_hz = self.rate_hz
        frequency, density = self._velocity.density(rate_hz)
        density *= rate_hz**2
        return max(
            bandwidth.bandwidth_of(frequency, density[j], rate_hz, step=float(step[j]))
            for j in joints
        )

    def _scored(self, joints: Index, step: Array, cutoffs: Array) -> "_Scored":
        """Score cut-offs (C,) Hz by some joints, with encoder steps (n,) rad."""
        rate_hz = self.rate_hz
        frequency, density = self._acceleration()
        top = (frequency > 0.2 * rate_hz) & (frequency < 0.4 * rate_hz)

        quantisation = _quantisation_density(step, rate_hz)
        values = np.zeros(len(cutoffs))
        noise_density = np.zeros(len(joints))
        for k, j in enumerate(joints):
            # The position's noise: the quantisation's, or what the top of the spectrum
            # shows.
            at_top = 0.0
            if top.any():
                of_position = density[j, top] / (2 * np.pi * frequency[top]) ** 4
                at_top = float(np.median(of_position))
            noise_density[k] = max(float(quantisation[j]), at_top, 1e-30)

            noise = bandwidth.differentiated_error(noise_density[k], cutoffs)
            signal = bandwidth.power_below(frequency, density[j], cutoffs) - noise
            # Power beyond the first point where noise takes over is noise, whatever its
            # level.
            signal = np.maximum.accumulate(np.maximum(signal, 1e-12))
            values += np.log(signal) - bandwidth.KAPPA * noise / signal
        return _Scored(values, noise_density)


class _Scored(NamedTuple):
    """J of each cut-off (C,) and the noise densities (m,) rad^2/Hz of m joints."""

    values: Array
    noise_density: Array


def _quantisation_density(step: Array, rate_hz: float) -> Array:
    """Return noise densities (n,) rad^2/Hz of positions rounded to steps (n,) rad."""
    return step**2 / 12 * 2 / rate_hz


def _candidates(highest_hz: float) -> Array:
    """Return the cut-offs that are compared, Hz."""
    lowest_hz = min(bandwidth.LOWEST_HZ, highest_hz / 2)
    return np.geomspace(lowest_hz, highest_hz, 120)


def survey_of_positions(q: Array, rate_hz: float) -> Survey:
    """Return the survey of positions (N, n) rad, made once while the array lives.

    A log is filtered at several cut-offs, and what they are chosen from is the same for
    all.
    """
    number = id(q)
    entry = _CACHE.get(number)
    if entry is not None and entry.q() is q and entry.survey.rate_hz == rate_hz:
        return entry.survey

    survey = Survey.of(q, rate_hz)
    forget = partial(_CACHE.pop, number, None)
    _CACHE[number] = _CachedSurvey(weakref.ref(q, lambda _: forget()), survey)
    return survey


@dataclass(frozen=True)
class _CachedSurvey:
    """A survey and the positions that it is of."""

    q: weakref.ref[Array]
    survey: Survey


_CACHE: dict[int, _CachedSurvey] = {}


class _Lengths(NamedTuple):
    """Segments of the spectra of acceleration and velocity, halves of the time scales.

    All in samples.
    """

    second: int
    velocity: int
    halves: list[int]


def _lengths(
    hz: float,
    samples: int,
    *,
    second_s: int = 8,
    velocity_s: int = 20,
    least_segment: int = 256,
) -> _Lengths:
    """Return the lengths for a log of a rate; segments are no longer than the log."""
    second = max(least_segment, int(second_s * hz))
    velocity = max(least_segment, int(velocity_s * hz))
    halves = [max(1, round(scale * hz / 2)) for scale in SCALES_S]
    return _Lengths(
        second=min(samples - 2, second),
        velocity=min(samples - 1, velocity),
        halves=[half for half in halves if 2 * half < samples],
    )
