"""A line at a fixed frequency of time: the mains, a fan, a pump.

    tau = A sin(2 pi f t + p) = a sin(2 pi f t) + b cos(2 pi f t)

A [N m], f [Hz]. Where the logs share a clock, t counts from the first log and one phase
p serves all; the frequency is then known to a small part of one over the time that the
logs span. Otherwise t counts from each log's start and every log has a phase of its own
(`clocks` says how many), as where the phase wanders from log to log: such a line is
known to be there, but cannot be predicted for another log.

A line is not taken for a disturbance if the motion makes it: if it is missing in some
of the logs that could show it, if its phase wanders within a log, if the modelled
torque has a line there of comparable size, or if all motions repeat with it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.repetition import repeats_with_motion
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.units import Value
from seqid_cli.robot.types import Robot
from seqid_cli.running import dilated
from seqid_cli.spectra import line_power
from seqid_cli.typing import Array, Complex, Mask

PEAK = 12.0  # power over that of the neighbourhood, below which nothing is looked at
NEIGHBOURHOOD_HZ = 1.5
# Of one over the longest log: lines are that far apart, and half a lobe of the window.
APART_BINS = 4.0
LOBE_BINS = 2.0
PIECES = 8  # values that a log is demodulated to
STEPS = 6.0  # frequencies per one over the span
MOST_STEPS = 200_000
MOST_PRODUCTS = 2_000_000  # frequencies times samples, worked on at once


@dataclass(frozen=True)
class Signal:
    """One log's values (N,) at `rate_hz`, the first at time `start` s.

    A value of zero does not count.
    """

    values: Array
    rate_hz: float
    start: float = 0.0

    @property
    def length_s(self) -> float:
        """Duration, s."""
        return len(self.values) / self.rate_hz


class Line(NamedTuple):
    """Frequency of a line [Hz] and its coherence [-].

    The coherence is 1 if amplitude and phase are always the same.
    """

    frequency: float
    coherence: float


def _nothing_known(frequencies: Array) -> Mask:
    """Return that nothing else makes lines at frequencies (F,) Hz."""
    return np.zeros(len(frequencies), dtype=bool)


def strongest_lines(
    signals: Sequence[Signal],
    low_hz: float,
    count: int,
    *,
    is_known: Callable[[Array], Mask] = _nothing_known,
) -> list[float]:
    """Find the frequencies that stand out of the summed power of some logs.

    Parameters
    ----------
    signals : sequence of Signal
    low_hz : float
        Lowest frequency [Hz] that is looked at.
    count : int
        Number of frequencies that are returned at most.
    is_known : callable, optional
        Of frequencies (F,) Hz: at which of them (F,) something else makes lines.

    Returns
    -------
    list of float
        Frequencies [Hz] that are not known, the clearest first.
    """
    longest_s = max((signal.length_s for signal in signals), default=0.0)
    top = 0.45 * min((signal.rate_hz for signal in signals), default=0.0)
    low = max(low_hz, 8.0 / longest_s) if longest_s > 0.0 else np.inf
    if low >= top:
        return []
    from scipy.ndimage import median_filter

    # Four frequencies per resolution of the longest log.
    spacing = 0.25 / longest_s
    grid = np.arange(low, top, spacing)
    power = _power(signals, grid)

    width = max(9, int(NEIGHBOURHOOD_HZ / spacing))
    floor = median_filter(power, size=min(width, len(grid)), mode="nearest")
    least_floor = 1e-12 * max(float(power.max()), 1e-300)
    clearness = power / np.maximum(floor, least_floor)

    # Neighbours of a line that is known, or was taken, are its own slopes.
    stands_out = clearness >= PEAK
    of_others = stands_out & is_known(grid)
    lobe = round(LOBE_BINS / (longest_s * spacing))
    stands_out &= ~dilated(of_others, lobe)
    lines: list[float] = []
    while len(lines) < count and stands_out.any():
        clearest = int(np.argmax(np.where(stands_out, clearness, 0.0)))
        lines.append(float(grid[clearest]))
        stands_out &= np.abs(grid - grid[clearest]) > APART_BINS / longest_s
    return lines


def _power(signals: Sequence[Signal], frequencies: Array) -> Array:
    """Return the summed power (F,) of some logs at frequencies (F,) Hz."""
    power = np.zeros(len(frequencies))
    for signal in signals:
        length = 4 * len(signal.values)
        frequency, spectrum = line_power(signal.values, signal.rate_hz, length)
        power += np.interp(frequencies, frequency, spectrum)
    return power


def clearness(signals: Sequence[Signal], frequency: float) -> float:
    """Return the power of some logs at a frequency [Hz] over that around it."""
    longest_s = max((signal.length_s for signal in signals), default=0.0)
    if longest_s <= 0.0:
        return 0.0
    spacing = 0.25 / longest_s
    half = max(4, int(0.5 * NEIGHBOURHOOD_HZ / spacing))
    offsets = spacing * np.arange(-half, half + 1, dtype=np.float64)
    power = _power(signals, np.asarray(frequency + offsets, dtype=np.float64))
    return float(power[half] / max(float(np.median(power)), 1e-300))


def amplitude(signal: Signal, frequency: float) -> float:
    """Return the amplitude of the signal's line at a frequency [Hz]."""
    pieces = _demodulated(signal, frequency)
    total = np.abs(pieces.weight @ pieces.z)
    return float(2.0 * total / max(float(pieces.weight.sum()), 1.0))


def refined(signals: Sequence[Signal], near: float) -> Line:
    """Sharpen a line's frequency by its phases; logs share the clock of their starts.

    Power tells the frequency to within one over the longest log, phases to a fraction
    of one over the time that the logs span. Demodulated to a few values per log, their
    search costs next to nothing.
    """
    pieces = [_demodulated(signal, near) for signal in signals]
    z = np.concatenate([piece.z for piece in pieces])
    t = np.concatenate([piece.t for piece in pieces])
    weight = np.concatenate([piece.weight for piece in pieces])

    longest_s = max(signal.length_s for signal in signals)
    reach = 0.75 / longest_s
    step = 1.0 / (STEPS * max(float(np.ptp(t)), longest_s))
    half = min(int(np.ceil(reach / step)), MOST_STEPS)
    offsets = step * np.arange(-half, half + 1)
    coherence = _coherence(z, t, weight, np.asarray(offsets, dtype=np.float64))
    centre = offsets[int(np.argmax(coherence))]

    for _ in range(3):  # each closes in by a factor of eight
        close = centre + step * np.linspace(-1.0, 1.0, 33)
        coherence = _coherence(z, t, weight, close)
        centre = close[int(np.argmax(coherence))]
        step = step / 8.0
    return Line(near + float(centre), float(coherence.max()))


def _coherence(z: Complex, t: Array, weight: Array, offsets: Array) -> Array:
    """Return the coherence (F,) of values z (M,) turned back by `offsets` (F,) Hz."""
    total = float(weight @ np.abs(z) ** 2) * float(weight.sum())
    n_parts = max(1, len(offsets) * len(t) // MOST_PRODUCTS)
    sums = []
    for part in np.array_split(offsets, n_parts):
        turned_back = np.exp(-2j * np.pi * np.outer(part, t))
        sums.append(np.abs(turned_back @ (weight * z)) ** 2)
    return np.concatenate(sums) / max(total, 1e-300)


class _Pieces(NamedTuple):
    """Means z (PIECES,) of a signal in equal pieces, turned back by a frequency.

    `t` (PIECES,) s are the mean times of the pieces, `weight` (PIECES,) the numbers of
    values in them.
    """

    z: Complex
    t: Array
    weight: Array


def _demodulated(signal: Signal, frequency: float) -> _Pieces:
    """Turn a signal back by a frequency and take means over equal pieces of it."""
    values = signal.values
    length = len(values)
    # Of equal steps the waves are products of a few: sine and cosine of every sample
    # would take most of the time.
    rows = max(1, math.isqrt(length))
    steps = np.arange(-(-length // rows)) * rows / signal.rate_hz
    coarse = _turned_back(frequency, signal.start + steps)
    fine = _turned_back(frequency, np.arange(rows) / signal.rate_hz)
    wave = np.multiply.outer(coarse, fine).ravel()[:length]

    # The first sample of each piece; a signal of a few values has no more pieces.
    n_pieces = min(PIECES, length)
    first = -(-np.arange(n_pieces) * length // max(n_pieces, 1))
    time = signal.start + np.arange(length) / signal.rate_hz
    counted = (values != 0.0).astype(np.float64)

    weight = np.add.reduceat(counted, first)
    number = np.maximum(weight, 1.0)
    z = np.asarray(np.add.reduceat(values * wave, first) / number, dtype=np.complex128)
    t = np.add.reduceat(time * counted, first) / number
    return _Pieces(z, t, weight)


def _turned_back(frequency: float, time: Array) -> Complex:
    """Return exp(-2 pi i f t) at times (M,) s."""
    # Sine and cosine of numbers cost a fraction of the exponential of complex ones.
    angle = 2.0 * np.pi * frequency * time
    return np.asarray(np.cos(angle) - 1j * np.sin(angle))


LOWEST_HZ = 1.0
LINES = 6  # looked at
COHERENT = 0.6
SAME = 0.4  # smallest share of the median amplitude that a log may show
# Share of the modelled torque's line below which the line is the model's error.
OF_MOTION = 0.3
LINE_OF_MOTION = 3.0  # power over that around it, from which the motion has a line


class PeriodicDisturbance(Effect):
    """Sine and cosine of time."""

    name = "periodic_disturbance"
    family = "measurement"
    settings = (
        Setting("frequency", "Hz", low=0.0, continuous=False),
        Setting("clocks", "1", low=0.0, continuous=False),
        Setting("span", "s", low=0.0, continuous=False),
    )
    wide = True
    over = "wave"
    alike = ("torque_ripple",)
    by_motion = False
    separate_by = (
        "the same motion at two speeds: a disturbance keeps its frequency, what the"
        " motion makes moves with the speed; a motion whose period is no multiple of"
        " the disturbance's"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return a sine and a cosine, for each log if each has its own clock."""
        n_clocks = round(settings["clocks"])
        if n_clocks == 0:
            return (Coefficient("sine", "N m"), Coefficient("cosine", "N m"))
        pairs = product(range(1, n_clocks + 1), ("sine", "cosine"))
        return tuple(Coefficient(f"{wave}_{log}", "N m") for log, wave in pairs)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield lines that keep amplitude and phase and are not made by the motion."""
        on_one_clock = all(scene.shared_clock for scene in scenes)
        n_clocks = 0.0 if on_one_clock else float(len(scenes))
        span = float(np.ptp([scene.time[[0, -1]] for scene in scenes]))

        residual = [
            _without_peaks(torque, scene.slides, joint)
            for torque, scene in zip(residual, scenes, strict=True)
        ]
        sliding = signals_of(scenes, joint, residual)
        modelled = signals_of(scenes, joint, [scene.modelled for scene in scenes])

        def repeats(frequencies: Array) -> Mask:
            """Return with which lines (F,) Hz all motions repeat."""
            of_logs = [repeats_with_motion(scene, frequencies) for scene in scenes]
            return np.asarray(np.logical_and.reduce(of_logs))

        for near in strongest_lines(sliding, LOWEST_HZ, LINES, is_known=repeats):
            signals = signals_of(scenes, joint, residual, near)
            clocks = n_clocks
            of_each = [near] * len(scenes)
            if on_one_clock:
                line = refined(signals, near)
                of_each = [line.frequency] * len(scenes)
            # The mains wander: from log to log nobody knows their phase.
            if not on_one_clock or line.coherence < COHERENT:
                clocks = float(len(scenes))
                line, of_each = _by_log(signals, near)

            # A log in which the joint does not move tells nothing of it.
            told = [signal for signal in signals if np.any(signal.values)]
            if not told:
                continue
            of_logs = _amplitudes(told, line.frequency)
            is_in_all = bool(of_logs.min() >= SAME * np.median(of_logs))
            is_steady = line.coherence >= COHERENT and is_in_all
            if is_steady and not (
                _is_of_motion(line.frequency, sliding, modelled)
                or all(
                    repeats_with_motion(scene, np.array([frequency])).any()
                    for scene, frequency in zip(scenes, of_each, strict=True)
                )
            ):
                yield {"frequency": line.frequency, "clocks": clocks, "span": span}

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return sine and cosine; nothing where every log has a phase of its own."""
        n_clocks = round(settings["clocks"])
        frequency = settings["frequency"]
        if n_clocks:
            note = (
                f"a line of {frequency:.6g} Hz whose phase is another in every log: no"
                " torque"
            )
            return {joint: Law(terms=("0.0",) * (2 * n_clocks), note=note)}

        law = Law(
            terms=("sin(turning * t)", "cos(turning * t)"),
            numbers={"turning": 2.0 * np.pi * frequency},
        )
        return {joint: law}

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Compute sine and cosine; zero for a log whose phase is not known."""
        n_clocks = round(settings["clocks"])
        line = self.laws(scene.robot, joint, {**settings, "clocks": 0.0})[joint]
        if n_clocks == 0:
            if scene.shared_clock:
                return {joint: line.columns(scene, joint)}
            return {joint: np.zeros((scene.samples, 2))}

        columns = np.zeros((scene.samples, 2 * n_clocks))
        if 0 <= scene.log < n_clocks:
            of_log = slice(2 * scene.log, 2 * scene.log + 2)
            columns[:, of_log] = line.columns(scene, joint)
        return {joint: columns}

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return amplitude and frequency, and the phase where all logs share it."""
        # One amplitude of every clock; their mean is weighted by their errors.
        variance = np.maximum(np.diag(covariance), 0.0).reshape(-1, 2).mean(axis=1)
        amplitudes = np.hypot(c[::2], c[1::2])
        errors = np.sqrt(variance)
        weight = 1.0 / np.maximum(errors, 1e-300) ** 2
        mean = float(np.sum(weight * amplitudes) / np.sum(weight))
        error = float(np.sum(weight) ** -0.5)

        # The Cramer-Rao bound of a line's frequency, over the time that one phase was
        # followed.
        span = max(settings["span"], 1e-9)
        frequency_error = np.sqrt(3.0) / np.pi / span * error / max(mean, 1e-300)
        values = [
            Value("amplitude", mean, error, robot.joints[joint].unit("N m")),
            Value(
                "frequency",
                settings["frequency"],
                min(float(frequency_error), 1e3),
                "Hz",
            ),
        ]
        if round(settings["clocks"]) == 0:
            phase = float(np.arctan2(c[1], c[0]))
            phase_error = float(errors[0] / max(amplitudes[0], 1e-300))
            values.append(Value("phase", phase, min(phase_error, np.pi), "rad"))
        return values


def _is_of_motion(
    frequency: float, sliding: Sequence[Signal], modelled: Sequence[Signal]
) -> bool:
    """Return whether a line [Hz] may be the error of one that the model's torque has.

    A motion without a line there makes none, however large its torque is.
    """
    of_sliding = np.median(_amplitudes(sliding, frequency))
    of_motion = np.median(_amplitudes(modelled, frequency))
    is_small = bool(of_sliding <= OF_MOTION * of_motion)
    return is_small and clearness(modelled, frequency) > LINE_OF_MOTION


def _amplitudes(signals: Sequence[Signal], frequency: float) -> Array:
    return np.array([amplitude(signal, frequency) for signal in signals])


def signals_of(
    scenes: Scenes, joint: int, torque: Sequence[Array], line_hz: float = np.inf
) -> list[Signal]:
    """Return the torque (N, n) of each log where it counts for a line.

    Below the cut-off that is only where the joint slides.
    """
    signals = []
    for scene, tau in zip(scenes, torque, strict=True):
        motion = scene.motion
        counts = scene.slides[:, joint] | (line_hz > motion.lowpass.cutoff_hz)
        values = np.where(counts, tau[:, joint], 0.0)
        signals.append(Signal(values, motion.rate_hz, scene.start))
    return signals


def _without_peaks(
    torque: Array, slides: Mask, joint: int, *, most: float = 4.0
) -> Array:
    """Clip a joint's torque to `most` times its median size; returns (N, n)."""
    # A line has 1.4 times the median size. Where friction is unknown, and at reversals,
    # the residual has more.
    clipped = torque.copy()
    of_joint = torque[:, joint]
    if not slides[:, joint].any():
        return clipped

    limit = most * float(np.median(np.abs(of_joint[slides[:, joint]])))
    if limit > 0.0:
        clipped[:, joint] = np.clip(of_joint, -limit, limit)
    return clipped


def _by_log(signals: Sequence[Signal], near: float) -> tuple[Line, list[float]]:
    """Return a line if only the phases within each log are known.

    Beside frequency and coherence of all logs stand the frequencies [Hz] of each.
    """
    lines = [refined([signal], near) for signal in signals]
    frequencies = np.array([line.frequency for line in lines])
    # The variance of a line's frequency falls with the third power of its length.
    weight = np.array([signal.length_s**3 for signal in signals])
    frequency = float(np.sum(weight * frequencies) / np.sum(weight))
    coherence = float(np.median([line.coherence for line in lines]))
    return Line(frequency, coherence), frequencies.tolist()
