"""How small the residual could become: torque noise in the band, that no model explains.

Noise is a property of a joint's drive, white and 1/f^a, looked for in all logs together; how much
of it passes a log's low-pass depends on the log. Three ways, the best that a joint's logs allow:

repeats
    Motion that comes back with a period, or in another log: half the mean square of the residual's
    differences, which no model of the motion can take away.
rests
    All joints stand for several lengths of the filter: the spectrum of the raw torque there, white
    noise and 1/f^a.
spectrum
    The least that the raw torque shows above the cut-off of any log while the joint slides, as
    white noise. What it really does there counts as noise; 1/f noise that white noise hides there
    is missing.

Fits of spectra are Whittle's: P. Whittle, "Estimation and information in stationary time series",
Arkiv foer Matematik 2(5), 1953.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import detrend

from seqid_cli.discover.noise import median_spectrum, nearest, power_gain, stretches
from seqid_cli.discover.periods import repeats_of
from seqid_cli.discover.rows import Rows
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.cutoff import encoder_step
from seqid_cli.motion.filtering import runs, shrink
from seqid_cli.motion.motion import Motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Way = Literal["repeats", "rests", "spectrum"]

FEWEST_REPEATED = 20.0  # periods of the cut-off that must repeat
SHORTEST_REST = 6.0  # periods of the cut-off
FEWEST_RESTED = 20.0  # periods of the cut-off, over all rests
STRETCH = 4.0  # periods of the cut-off per spectrum, while joints move
FEWEST_FREQUENCIES = 8
GRID = 400  # frequencies, over which a band is integrated
EXPONENTS = (1.0, 0.5, 0.75, 1.25, 1.5)
CLEARLY = 3.0  # log-likelihood that flicker, or an exponent other than the first, must gain
BELOW = 4.0  # times the lowest frequency seen, to which 1/f is continued
ABOVE = 2.0  # cut-offs, from which the torque is taken for noise
UP_TO = 6.0  # cut-offs: what lies further off tells little of the band
NYQUIST_SHARE = 0.9
ROUNDS = 30


@dataclass(frozen=True)
class NoiseFloor:
    """RMS (n,) N m of low-passed torque noise, and how each joint's was found."""

    rms: Array
    ways: tuple[Way, ...]


def noise_floor(
    recordings: Sequence[Recording],
    scenes: Sequence[Scene],
    rows: Rows,
    residual: Sequence[Array],
    judged: Collection[int] | None = None,
) -> NoiseFloor:
    """Find the noise floor of every joint.

    Parameters
    ----------
    recordings : sequence of Recording
        With torque.
    scenes : sequence of Scene
        Of the same logs.
    rows : Rows
        Of the same scenes.
    residual : sequence of (N, n) arrays
        Low-passed residual [N m] at the scenes' samples after all that was found has been taken
        out; zero where it does not count.
    judged : collection of int, optional
        The logs whose floor is wanted, by number; the others only help to find the noise.

    Returns
    -------
    NoiseFloor
        Never above the RMS of `residual` over the rows of these logs.
    """
    wanted = range(len(scenes)) if judged is None else sorted(judged)
    rested, lowest = _from_rests(recordings, scenes), _above_cutoff(recordings, scenes)
    repeats = _repeats(scenes, residual)
    floors, ways = [], []
    for j in range(rows.n):
        way, level = _level(j, repeats, rested, float(lowest[j]))
        parts = [residual[k][rows.picked[k]][rows.used[k][:, j], j] for k in wanted]
        weight = np.array([float(len(part)) for part in parts])
        squares = np.array([level.square(scenes[k].motion) for k in wanted])
        moved = weight > 0  # a log without rows may have shown no noise either
        mean = float(weight[moved] @ squares[moved]) / max(float(weight.sum()), 1.0)
        floors.append(min(float(np.sqrt(mean)), rms(np.concatenate(parts))))
        ways.append(way)
    return NoiseFloor(np.array(floors), tuple(ways))


@dataclass(frozen=True)
class Level:
    """Torque noise of one joint: two-sided density w + c f^-a, constant below `least` Hz."""

    white: float  # N^2 m^2 / Hz
    flicker: float = 0.0
    exponent: float = EXPONENTS[0]
    least: float = 0.0

    def square(self, motion: Motion) -> float:
        """Mean square N^2 m^2 that two passes of a log's low-pass leave."""
        of_white, of_flicker = _passed(motion, self.exponent, self.least)
        return self.white * of_white + self.flicker * of_flicker


def _passed(motion: Motion, exponent: float, least: float = 0.0) -> tuple[float, float]:
    """Mean squares after two passes of white noise and of 1/f^a noise of unit density."""
    top = min(0.5 * motion.rate_hz, 2.0 * motion.lowpass.cutoff_hz)
    frequency = np.geomspace(1.0 / motion.t[-1], top, GRID)
    gain = 2.0 * power_gain(motion.lowpass, frequency, 2)
    coloured = gain * np.maximum(frequency, least) ** -exponent
    return float(np.trapezoid(gain, frequency)), float(np.trapezoid(coloured, frequency))


def _level(
    joint: int, repeats: Repeats, rested: Sequence[Level] | None, lowest: float
) -> tuple[Way, Level]:
    """Noise of one joint by the best way that there is."""
    if repeats.periods[joint] >= FEWEST_REPEATED:
        white = min(lowest, rested[joint].white if rested else np.inf)
        return "repeats", repeats.level(joint, white)
    if rested:
        return "rests", rested[joint]
    return "spectrum", Level(lowest)


def rms(values: Array) -> float:
    """Root of the mean square; zero of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


@dataclass(frozen=True)
class Repeats:
    """What differs between repeats: squares (S, n) and samples (S, n) by log, periods (n,)."""

    squares: Array
    samples: Array
    periods: Array
    motions: tuple[Motion, ...]

    def level(self, joint: int, white: float) -> Level:
        """The joint's noise: as white as can be, the rest 1/f."""
        at = np.flatnonzero(self.samples[:, joint])
        weight = self.samples[at, joint] / self.samples[at, joint].sum()
        total = 0.5 * float(self.squares[at, joint].sum() / self.samples[at, joint].sum())
        passed = np.array([_passed(self.motions[k], EXPONENTS[0]) for k in at])
        of_white, of_flicker = weight @ passed
        white = min(white, total / float(of_white))
        return Level(white, (total - white * float(of_white)) / float(of_flicker))


def _repeats(scenes: Sequence[Scene], residual: Sequence[Array]) -> Repeats:
    shape = (len(scenes), scenes[0].robot.n)
    square, count, periods = np.zeros(shape), np.zeros(shape), np.zeros(shape[1])
    for repeat in repeats_of(scenes):
        then = scenes[repeat.second].motion
        own = residual[repeat.first][repeat.at]
        at = repeat.then * then.rate_hz
        low = np.clip(np.floor(at).astype(int), 0, then.samples - 2)
        share = (at - low)[:, None]
        before, after = residual[repeat.second][low], residual[repeat.second][low + 1]
        counts = (own != 0) & (before != 0) & (after != 0)
        # Straight lines between two samples take away a share of what is near the cut-off.
        off = before * (1 - share) + after * share - own
        square[repeat.first] += np.sum(np.where(counts, off**2, 0.0), axis=0)
        count[repeat.first] += counts.sum(axis=0)
        periods += counts.sum(axis=0) / then.rate_hz * then.lowpass.cutoff_hz
    return Repeats(square, count, periods, tuple(scene.motion for scene in scenes))


@dataclass(frozen=True)
class Spectrum:
    """Two-sided density (F, n) of one log's torque noise at frequencies (F,) Hz."""

    frequency: Array
    density: Array
    segments: int
    least: Array  # (n,) density of the torque's quantisation


def _at_rest(recording: Recording, scene: Scene) -> Spectrum | None:
    """Spectrum of the raw torque while all joints stand."""
    assert recording.tau is not None
    motion, rate = scene.motion, recording.rate_hz
    still = ~nearest(motion.moving, len(recording.t)).any(axis=1)
    quiet = shrink(still & recording.valid, round(1.2 * rate / motion.lowpass.cutoff_hz))
    pieces = runs(quiet, len(quiet))
    lengths = [b - a for a, b in pieces]
    lengths = [x for x in lengths if x >= SHORTEST_REST * rate / motion.lowpass.cutoff_hz]
    if sum(lengths) < FEWEST_RESTED * rate / motion.lowpass.cutoff_hz:
        return None
    length = int(np.median(lengths))
    starts = [s for a, b in pieces for s in range(a, b - length + 1, length)]
    segments = np.stack([detrend(recording.tau[s : s + length], axis=0) for s in starts])
    density = np.mean(np.abs(np.fft.rfft(segments, axis=1)) ** 2, axis=0) / (rate * length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    kept = (np.arange(len(frequency)) >= 2) & (frequency < 0.5 * NYQUIST_SHARE * rate)
    return Spectrum(frequency[kept], density[kept], len(starts), _quantised(recording))


def _quantised(recording: Recording) -> Array:
    """Density (n,) of the noise that rounding the torque makes."""
    assert recording.tau is not None
    least: Array = encoder_step(recording.tau) ** 2 / 12.0 / recording.rate_hz
    return least


def _from_rests(recordings: Sequence[Recording], scenes: Sequence[Scene]) -> list[Level] | None:
    """Noise of every joint from the log that rests longest; None where none does for long."""
    spectra = [_at_rest(*pair) for pair in zip(recordings, scenes, strict=True)]
    found = [spectrum for spectrum in spectra if spectrum is not None]
    if not found:
        return None
    best = max(found, key=lambda spectrum: spectrum.segments * len(spectrum.frequency))
    levels = []
    for density, least in zip(best.density.T, best.least, strict=True):
        white, flicker, a = fitted(best.frequency, density, EXPONENTS, averaged=best.segments)
        levels.append(Level(max(white, least), flicker, a, best.frequency[0] / BELOW))
    return levels


def fitted(
    frequency: Array, density: Array, exponents: Sequence[float], *, averaged: int
) -> tuple[float, float, float]:
    """White noise w and 1/f^a noise c f^-a by Whittle's likelihood.

    Parameters
    ----------
    frequency, density : (F,) arrays
        Hz; periodogram, the mean of `averaged` ones.
    exponents : sequence of float
        Values of a to choose from; another than the first must be clearly better.
    averaged : int

    Returns
    -------
    tuple of float
        w, c and a; c is zero where white noise alone is about as likely.
    """
    if not density.any():
        return 0.0, 0.0, exponents[0]
    flat = float(density.mean())
    best, result = _unlikely(density, np.full_like(density, flat)), (flat, 0.0, exponents[0])
    for exponent in exponents:
        columns = np.stack([np.ones_like(frequency), frequency**-exponent], axis=1)
        c, shape = _whittle(columns, density)
        score = _unlikely(density, shape)
        if averaged * (best - score) > CLEARLY:
            best, result = score, (float(c[0]), float(c[1]), exponent)
    return result


def _unlikely(density: Array, shape: Array) -> float:
    """Negative log-likelihood of one periodogram."""
    return float(np.sum(np.log(shape) + density / shape))


def _whittle(columns: Array, density: Array) -> tuple[Array, Array]:
    """Coefficients (2,) >= 0 and the density (F,) that they give, by reweighted least squares."""
    tiny = 1e-9 * float(density.mean())
    shape = np.full_like(density, density.mean())
    for _ in range(ROUNDS):
        c, _rest = nnls(columns / shape[:, None], density / shape)
        shape = np.maximum(columns @ c, tiny)
    return c, shape


def _above_cutoff(recordings: Sequence[Recording], scenes: Sequence[Scene]) -> Array:
    """Density (n,) N^2 m^2 / Hz of white noise, the least that any log shows above its cut-off."""
    n = scenes[0].robot.n
    shown = [
        [_in_motion(recording, scene, j) for j in range(n)]
        for recording, scene in zip(recordings, scenes, strict=True)
    ]
    least: Array = np.min(shown, axis=0)
    return least


def _in_motion(recording: Recording, scene: Scene, joint: int) -> float:
    """Density of the raw torque above the cut-off where the joint slides, away from reversals.

    Where it never slides for long enough, of all the log; infinite of a log that shows none.
    """
    assert recording.tau is not None
    rate, cutoff = recording.rate_hz, scene.motion.lowpass.cutoff_hz
    slides = scene.slides[:, [joint]]
    length = min(round(STRETCH * rate / cutoff), len(recording.t))
    slid = nearest(slides, len(recording.t))[:, 0] & recording.valid
    starts = stretches(slid, length) or stretches(recording.valid, length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    top = min(UP_TO * cutoff, 0.5 * NYQUIST_SHARE * rate)
    kept = (frequency > ABOVE * cutoff) & (frequency < top)
    if not starts or kept.sum() < FEWEST_FREQUENCIES:
        return np.inf
    density = median_spectrum(recording.tau[:, joint], starts, length, rate)[kept]
    return max(float(np.mean(density)), float(_quantised(recording)[joint]))
