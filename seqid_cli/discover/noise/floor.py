"""How small the residual could become: noise in the band, that no model explains.

It is torque noise and what the encoder's noise makes of the motion. The latter is drawn (see
`encoder`). Torque noise is a property of a joint's drive, white and 1/f^a, looked for in all logs
together; how much of it passes a log's low-pass depends on the log. Two ways, the better first:

rests
    All joints stand for several periods of the cut-off: the spectrum of the raw torque there. A
    controller that hunts between two counts of its encoder shows more than noise; that is seen
    where a rest shows more than motion does at the same frequencies.
spectrum
    What the raw torque shows above the cut-off while the joint slides, and what is left of it at
    the top of the band, where there is no motion, as white noise and 1/f noise that goes on below.
    Control and steps of the motion only add to it: of all that the logs show the least counts, with
    what agrees with it. What colour the noise has below stays open: the interval reaches from white
    noise of the density at the top up to all that is left.

The estimate is one of its own: what a model leaves of the torque does not bound it. Rests whose
interval lies above all that is left are refuted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np
from scipy.signal import detrend

from seqid_cli.discover.noise.level import Level, Spectrum, level_of
from seqid_cli.discover.noise.spectra import (
    LEAST_SHARE,
    median_spectrum,
    nearest,
    power_gain,
    stretches,
)
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs, shrink
from seqid_cli.motion.motion import Motion, encoder_resolution
from seqid_cli.motion.segmentation import unmoved
from seqid_cli.robot.types import Joint
from seqid_cli.typing import Array, Mask

Way = Literal["rests", "spectrum"]

SEED = 0  # of the draws behind the interval
STRETCH = 4.0  # periods of the cut-off: of a rest, at least, and per spectrum while joints move
FEWEST_FREQUENCIES = 8
EXPONENTS = (1.0, 0.5, 0.75, 1.25, 1.5)  # of 1/f^a noise at rest
FLICKER = (1.0,)  # the same above the cut-off, where exponents are not told apart
NYQUIST_SHARE = 0.9
FEWEST_STRETCHES = 2
# Bins of a tapered spectrum that count as one, times the variance of a median over that of a mean.
HANN_MEDIAN = 1.5 * 2.08
NORMAL_95 = np.array([0.0, -1.96, 1.96])  # a normal deviate's middle, and the ends of its interval
NOTHING = Spectrum(np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class NoiseFloor:
    """RMS (n,) N m that a right model leaves, and how each joint's torque noise was found.

    `low`, `high` (n,) N m are its 95 % interval: what the spectrum's estimate leaves open, how much
    the noise of logs so short scatters about it, and how well the encoder's part is known.
    """

    rms: Array
    low: Array
    high: Array
    ways: tuple[Way, ...]

    def interval(self, joint: int) -> tuple[float, float]:
        """95 % interval of one joint's floor, N m."""
        return float(self.low[joint]), float(self.high[joint])

    def doubts(self, left: Array, joints: Sequence[Joint]) -> tuple[str, ...]:
        """Joints at which a model leaves less than the interval's lower end.

        Parameters
        ----------
        left : (n,) array
            RMS, N m, of what a model leaves of the samples that the floor is of; NaN where unknown.
        joints : sequence of Joint
        """
        return tuple(
            f"joint {joint.name}: {rest:.3g} {joint.unit('N m')} is left, less than the noise "
            f"floor's interval, {low:.3g} to {high:.3g} {joint.unit('N m')}: the floor's estimate "
            "is doubtful there; a log with rests of several seconds gives a better one"
            for joint, rest, low, high in zip(joints, left, self.low, self.high, strict=True)
            if rest < low
        )


def noise_floor(
    recordings: Sequence[Recording],
    scenes: Sequence[Scene],
    residual: Sequence[Array],
    echo: Sequence[Array],
    *,
    rows: Rows | None = None,
    judged: int | None = None,
) -> NoiseFloor:
    """Find the noise floor of every joint where it slides; an estimate of its own.

    Parameters
    ----------
    recordings : sequence of Recording
        With torque.
    `scenes` : sequence of `Scene`
        Of the same logs.
    residual : sequence of (N, n) arrays
        Low-passed residual [N m] at the data sets' samples after all that was found has been taken
        out; zero where it does not count.
    echo : sequence of (N, n) arrays
        The part of it that the encoder's noise makes [N m], see `encoder_residuals`.
    rows : Rows, optional
        Those that the floor is of; by default all samples at which a joint slides.
    judged : int, optional
        How many of the logs the floor is of, the first ones; the others only help to find the
        noise. By default all.
    """
    moving, rng = _in_motion(recordings, scenes, residual, echo), np.random.default_rng(SEED)
    ways, found = list[Way](), []
    for j, (rests, others) in enumerate(zip(_at_rest(recordings, scenes), moving, strict=True)):
        of = [(scene, scene.slides[:, j]) for scene in scenes[:judged]]
        slid = [(x.motion, float(m.sum()) / x.motion.rate_hz) for x, m in of if m.any()]
        heard, left = (_rms_of(values, of, j) for values in (echo, residual))
        heard = heard if rows is None else rms(rows.torque(j, [e[:, j] for e in echo]))
        quiet = [one for one in rests if not _exceeds(one, others)]
        way: Way = "rests"
        middle, low, high = _floor(level_of(_together(quiet), EXPONENTS), slid, heard, rng)
        # Of noise no more can be there than is left of the torque in all.
        if not quiet or low > left:
            way = "spectrum"
            level = level_of(_agreeing(others), FLICKER)
            middle, low, high = _floor(level, slid, heard, rng)
            white = _floor(Level.known(_top(others)), slid, heard, rng)
            low, high = min(low, white[1]), max(high, left)
        ways.append(way)
        found.append((middle, low, high))
    middle, low, high = np.array(found).T
    return NoiseFloor(middle, low, high, tuple(ways))


def _floor(
    level: Level,
    slid: Sequence[tuple[Motion, float]],
    heard: float,
    rng: np.random.Generator,
    *,
    encoder_error: float = 0.25,
) -> Array:
    """Estimate of torque noise and the encoder's part, and the ends of its interval, N m.

    `encoder_error` is the relative standard error of the encoder's part.
    """
    return np.hypot(level.rms(slid, rng), heard * np.exp(encoder_error * NORMAL_95))


def _rms_of(values: Sequence[Array], of: Sequence[tuple[Scene, Mask]], joint: int) -> float:
    """RMS of a joint's values where it slides and they count."""
    own = np.concatenate([x[m, joint] for x, (_, m) in zip(values, of, strict=False)])
    return rms(own[own != 0.0])


def _exceeds(rest: Spectrum, spectra: Sequence[Spectrum], *, errors: float = 4.0) -> bool:
    """Whether joints that stand show more than a joint that slides, at the same frequencies.

    By more than so many standard errors. A controller that hunts between two counts of its encoder
    does; noise is the same in both.
    """
    for other in spectra:
        shared = rest.within(float(other.frequency[0]), float(other.frequency[-1]))
        if len(shared.frequency) and not _agrees(shared, other, errors=errors):
            return True
    return False


def _agrees(one: Spectrum, other: Spectrum, *, errors: float = 2.0) -> bool:
    """Whether the first is not above the other beyond so many standard errors."""
    error = float(np.sqrt(one.mean[1] + other.mean[1]))
    return one.mean[0] - other.mean[0] <= errors * other.mean[0] * error


def _together(spectra: Sequence[Spectrum]) -> Spectrum:
    return reduce(Spectrum.beside, spectra, NOTHING)


def _agreeing(spectra: Sequence[Spectrum]) -> Spectrum:
    """The least of the spectra together with those that agree with it.

    What a log shows beside noise only adds to it; the least alone would be the luckiest.
    """
    least = min(spectra, key=lambda one: one.mean[0], default=NOTHING)
    return _together([one for one in spectra if _agrees(one, least)])


def _top(spectra: Sequence[Spectrum]) -> float:
    """Density of the upper half of the frequencies: noise that does not rise is no less below."""
    one = _agreeing(spectra)
    return one.within(float(np.median(one.frequency)), np.inf).mean[0] if spectra else 0.0


def rms(values: Array) -> float:
    """Root of the mean square; zero of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _at_rest(recordings: Sequence[Recording], scenes: Sequence[Scene]) -> list[list[Spectrum]]:
    """Spectra of the raw torque while all joints stand, by joint; none of logs that hardly rest."""
    result: list[list[Spectrum]] = [[] for _ in range(scenes[0].robot.n)]
    for recording, scene in zip(recordings, scenes, strict=True):
        rests = _rests(recording, scene)
        for j, spectra in enumerate(result):
            if rests is not None:
                spectra.append(_rested(recording, rests, j))
    return result


def _rests(
    recording: Recording, scene: Scene, *, fewest: float = 20.0, settling: float = 1.2
) -> list[slice] | None:
    """Pieces of equal length in which all joints stand; None where that is not for long enough.

    In periods of the cut-off: `fewest` in all, without `settling` at both ends of a rest, in which
    a move dies away.
    """
    period = recording.rate_hz / scene.motion.lowpass.cutoff_hz
    still = unmoved(recording.q, encoder_resolution(scene.robot), round(STRETCH * period))
    quiet = shrink(still & recording.valid, round(settling * period))
    pieces = [(a, b) for a, b in runs(quiet, len(quiet)) if b - a >= STRETCH * period]
    if sum(b - a for a, b in pieces) < fewest * period:
        return None
    length = int(np.median([b - a for a, b in pieces]))
    return [slice(s, s + length) for a, b in pieces for s in range(a, b - length + 1, length)]


def _rested(recording: Recording, rests: Sequence[slice], joint: int) -> Spectrum:
    assert recording.tau is not None
    rate, length = recording.rate_hz, rests[0].stop - rests[0].start
    pieces = detrend(np.stack([recording.tau[piece, joint] for piece in rests]), axis=1)
    density = np.mean(np.abs(np.fft.rfft(pieces, axis=1)) ** 2, axis=0) / (rate * length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    kept = (np.arange(len(frequency)) >= 2) & (frequency < 0.5 * NYQUIST_SHARE * rate)
    averaged = np.full(int(kept.sum()), float(len(rests)))
    return Spectrum(frequency[kept], density[kept], averaged, _quantised(recording, joint))


def _quantised(recording: Recording, joint: int) -> float:
    """Density of the noise that rounding the torque makes."""
    assert recording.tau is not None
    return float(encoder_step(recording.tau[:, [joint]])[0] ** 2 / 12.0 / recording.rate_hz)


def _in_motion(
    recordings: Sequence[Recording],
    scenes: Sequence[Scene],
    residual: Sequence[Array],
    echo: Sequence[Array],
) -> list[list[Spectrum]]:
    """Spectra above the cut-off and just below it, by joint, of the logs that show any."""
    result = []
    for j in range(scenes[0].robot.n):
        logs = zip(recordings, scenes, residual, echo, strict=True)
        each = [(_slid(log, x, j), _top_of_band(log, x, r, e, j)) for log, x, r, e in logs]
        result.append([one for pair in each for one in pair if one is not None])
    return result


def _top_of_band(
    recording: Recording,
    scene: Scene,
    residual: Array,
    echo: Array,
    joint: int,
    *,
    band: tuple[float, ...] = (0.45, 0.95),
) -> Spectrum | None:
    """What is left of the torque at the top of the band, the low-pass undone: there is no motion.

    Steps of the torque, which reach above the cut-off, the model has below it. What the encoder's
    noise makes is taken off. `band` are the cut-offs between which all is taken for noise.
    """
    motion = scene.motion
    rate, cutoff = motion.rate_hz, motion.lowpass.cutoff_hz
    length = min(round(STRETCH * rate / cutoff), motion.samples)
    starts = stretches(scene.slides[:, joint] & (residual[:, joint] != 0.0), length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    kept = (frequency > band[0] * cutoff) & (frequency < band[1] * cutoff)
    if len(starts) < FEWEST_STRETCHES or not kept.any() or not motion.lowpass.active:
        return None
    whole, heard = (
        median_spectrum(values[:, joint], starts, length, rate)[kept] for values in (residual, echo)
    )
    density = np.maximum(whole - heard, LEAST_SHARE * whole)
    density = density / power_gain(motion.lowpass, frequency[kept], 2)
    averaged = np.full(int(kept.sum()), len(starts) / HANN_MEDIAN)
    return Spectrum(frequency[kept], density, averaged, _quantised(recording, joint))


def _slid(
    recording: Recording, scene: Scene, joint: int, *, above: float = 1.5, up_to: float = 10.0
) -> Spectrum | None:
    """The raw torque above the cut-off where the joint slides, away from reversals.

    If it never does for long, of all the log. From `above` cut-offs on all is taken for noise; what
    lies beyond `up_to` tells little of the band.
    """
    assert recording.tau is not None
    rate, cutoff = recording.rate_hz, scene.motion.lowpass.cutoff_hz
    length = min(round(STRETCH * rate / cutoff), len(recording.t))
    slides = nearest(scene.slides[:, [joint]], len(recording.t))[:, 0] & recording.valid
    starts = stretches(slides, length) or stretches(recording.valid, length)
    frequency = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    top = min(up_to * cutoff, 0.5 * NYQUIST_SHARE * rate)
    kept = (frequency > above * cutoff) & (frequency < top)
    if not starts or kept.sum() < FEWEST_FREQUENCIES:
        return None
    density = median_spectrum(recording.tau[:, joint], starts, length, rate)[kept]
    averaged = np.full(int(kept.sum()), len(starts) / HANN_MEDIAN)
    return Spectrum(frequency[kept], density, averaged, _quantised(recording, joint))
