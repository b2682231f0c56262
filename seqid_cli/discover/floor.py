"""How small the residual could become: torque noise in the band, that no model explains.

Three ways, the best that a joint's logs allow:

repeats
    Motion that comes back with a period, or in another log: half the mean square of the residual's
    differences, which no model of the motion can take away.
rests
    All joints stand for several lengths of the filter: the spectrum of the raw torque there, white
    noise and 1/f^a, integrated over the band.
spectrum
    The same of the raw torque above the cut-off, with a = 1, while the joint slides. What it really
    does there counts as noise; 1/f noise that white noise hides there is missing.

Fits of spectra are Whittle's: P. Whittle, "Estimation and information in stationary time series",
Arkiv foer Matematik 2(5), 1953.
"""

from __future__ import annotations

from collections.abc import Sequence
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

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Way = Literal["repeats", "rests", "spectrum"]

FEWEST_REPEATED = 20.0  # periods of the cut-off that must repeat
SHORTEST_REST = 6.0  # periods of the cut-off
FEWEST_RESTED = 20.0  # periods of the cut-off, over all rests
STRETCH = 4.0  # periods of the cut-off per spectrum, while joints move
EXPONENTS = (1.0, 0.5, 0.75, 1.25, 1.5)
CLEARLY = 3.0  # log-likelihood that flicker, or an exponent other than the first, must gain
BELOW = 4.0  # times the lowest frequency seen, to which 1/f is continued
ABOVE = 2.0  # cut-offs, from which the torque is taken for noise
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

    Returns
    -------
    NoiseFloor
        Never above the RMS of `residual` over the rows.
    """
    least = [rms(rows.of(j, [r[:, j] for r in residual])) for j in range(rows.n)]
    repeated = _from_repeats(scenes, residual)
    rested = _from_rests(recordings, scenes)
    floors, ways = [], []
    for j in range(rows.n):
        found: list[tuple[Way, float]] = [
            ("repeats", repeated[j]),
            ("rests", rested[j]),
            ("spectrum", _above_cutoff(recordings, scenes, j)),
        ]
        way, value = next((w, x) for w, x in found if np.isfinite(x))
        floors.append(min(value, least[j]))
        ways.append(way)
    return NoiseFloor(np.array(floors), tuple(ways))


def rms(values: Array) -> float:
    """Root of the mean square; zero of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _from_repeats(scenes: Sequence[Scene], residual: Sequence[Array]) -> Array:
    """RMS (n,) of what differs between repeats, NaN where too little repeats."""
    n = scenes[0].robot.n
    square, count, periods = np.zeros(n), np.zeros(n), np.zeros(n)
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
        square += np.sum(np.where(counts, off**2, 0.0), axis=0)
        count += counts.sum(axis=0)
        periods += counts.sum(axis=0) / then.rate_hz * then.lowpass.cutoff_hz
    enough = periods >= FEWEST_REPEATED
    return np.where(enough, np.sqrt(0.5 * square / np.maximum(count, 1)), np.nan)


@dataclass(frozen=True)
class Spectrum:
    """Two-sided density (F, n) of one log's torque noise at frequencies (F,) Hz, and its scene."""

    frequency: Array
    density: Array
    segments: int
    scene: Scene
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
    return Spectrum(frequency[kept], density[kept], len(starts), scene, _quantised(recording))


def _quantised(recording: Recording) -> Array:
    """Density (n,) of the noise that rounding the torque makes."""
    assert recording.tau is not None
    least: Array = encoder_step(recording.tau) ** 2 / 12.0 / recording.rate_hz
    return least


def _from_rests(recordings: Sequence[Recording], scenes: Sequence[Scene]) -> Array:
    """RMS (n,) in the band, over the logs that rest for long enough; NaN where none does."""
    spectra = [_at_rest(*pair) for pair in zip(recordings, scenes, strict=True)]
    found = [spectrum for spectrum in spectra if spectrum is not None]
    if not found:
        return np.full(scenes[0].robot.n, np.nan)
    square = np.array([_integrated(spectrum, EXPONENTS) for spectrum in found])
    weight = np.array([spectrum.segments * len(spectrum.frequency) for spectrum in found])
    mean: Array = np.sqrt(np.average(square, axis=0, weights=weight))
    return mean


def _integrated(spectrum: Spectrum, exponents: Sequence[float]) -> Array:
    """Mean square (n,) N^2 m^2 of the fitted noise after the scene's two passes."""
    motion = spectrum.scene.motion
    top = min(0.5 * motion.rate_hz, 2.0 * motion.lowpass.cutoff_hz)
    frequency = np.geomspace(1.0 / motion.t[-1], top, 400)
    gain = power_gain(motion.lowpass, frequency, 2)
    squares = []
    for density, least in zip(spectrum.density.T, spectrum.least, strict=True):
        white, flicker, exponent = fitted(
            spectrum.frequency, density, exponents, averaged=spectrum.segments
        )
        seen = np.maximum(frequency, spectrum.frequency[0] / BELOW)
        shape = np.maximum(white, least) + flicker * seen**-exponent
        squares.append(2.0 * float(np.trapezoid(shape * gain, frequency)))
    return np.array(squares)


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


def _above_cutoff(recordings: Sequence[Recording], scenes: Sequence[Scene], joint: int) -> float:
    """RMS [N m] in the band, from what the raw torque shows above it while the joint moves."""
    squares, weights = [], []
    for recording, scene in zip(recordings, scenes, strict=True):
        spectrum = _in_motion(recording, scene, joint)
        if spectrum is not None:
            squares.append(float(_integrated(spectrum, (1.0,))[0]))
            weights.append(spectrum.segments)
    return float(np.sqrt(np.average(squares, weights=weights))) if squares else np.inf


def _in_motion(recording: Recording, scene: Scene, joint: int) -> Spectrum | None:
    """Spectrum of the raw torque above the cut-off where the joint slides, away from reversals.

    Where it never slides for long enough, of all the log.
    """
    assert recording.tau is not None
    rate, cutoff = recording.rate_hz, scene.motion.lowpass.cutoff_hz
    slides = scene.slides[:, [joint]]
    length = min(round(STRETCH * rate / cutoff), len(recording.t))
    slid = nearest(slides, len(recording.t))[:, 0] & recording.valid
    starts = stretches(slid, length) or stretches(recording.valid, length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    kept = (frequency > ABOVE * cutoff) & (frequency < 0.5 * NYQUIST_SHARE * rate)
    if not starts or kept.sum() < 8:
        return None
    density = median_spectrum(recording.tau[:, joint], starts, length, rate)[kept, None]
    least = _quantised(recording)[[joint]]
    return Spectrum(frequency[kept], density, len(starts), scene, least)
