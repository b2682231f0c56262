"""A line at a fixed frequency of time: the mains, a fan, a pump.

    tau = A sin(2 pi f t + p) = a sin(2 pi f t) + b cos(2 pi f t)

A [N m], f [Hz]. Where the logs share a clock, t counts from the first log and one phase
p serves all; the frequency is then known to a small part of one over the time that the
logs span. Otherwise t counts from each log's start and every log has a phase of its own
(`clocks` says how many): such a line is known to be there, but cannot be predicted for
another log.

A line is not taken for a disturbance if the motion makes it: if it is missing in some
of the logs, if its phase wanders, or if the modelled torque has a line there of
comparable size.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import periodogram

from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
)
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.model.effects.units import Value
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Complex, Mask

PEAK = 12.0  # power over that of the neighbourhood, below which nothing is looked at
NEIGHBOURHOOD_HZ = 1.5
PIECES = 8  # values that a log is demodulated to
STEPS = 6.0  # frequencies per one over the span
MOST_STEPS = 200_000


@dataclass(frozen=True)
class Signal:
    """One log's values (N,) at `rate_hz`, the first at time `start` s; zero where none counts."""

    values: Array
    rate_hz: float
    start: float = 0.0

    @property
    def length_s(self) -> float:
        """Duration."""
        return len(self.values) / self.rate_hz


def strongest_lines(
    signals: Sequence[Signal], low_hz: float, count: int
) -> list[float]:
    """At most `count` frequencies [Hz] from `low_hz` on that stand out of the summed power.

    The clearest comes first.
    """
    longest = max((signal.length_s for signal in signals), default=0.0)
    top = 0.45 * min((signal.rate_hz for signal in signals), default=0.0)
    low = max(low_hz, 8.0 / longest) if longest > 0.0 else np.inf
    if low >= top:
        return []
    grid = np.arange(low, top, 0.25 / longest)
    power = np.zeros(len(grid))
    for own in signals:
        size = 4 * len(own.values)
        lines = periodogram(own.values, own.rate_hz, "hann", size, scaling="spectrum")
        power += np.interp(grid, *lines)
    width = max(9, int(NEIGHBOURHOOD_HZ / (0.25 / longest)))
    floor = median_filter(power, size=min(width, len(grid)), mode="nearest")
    ratio = power / np.maximum(floor, 1e-12 * max(float(power.max()), 1e-300))
    found: list[float] = []
    for k in np.argsort(-ratio):
        if ratio[k] < PEAK or len(found) == count:
            break
        if all(abs(grid[k] - f) > 4.0 / longest for f in found):
            found.append(float(grid[k]))
    return found


def amplitude(signal: Signal, frequency: float) -> float:
    """Amplitude of the signal's line at a frequency, over the values that count."""
    z, _, weight = _demodulated(signal, frequency)
    return float(2.0 * np.abs(weight @ z) / max(float(weight.sum()), 1.0))


def refined(signals: Sequence[Signal], near: float) -> tuple[float, float]:
    """Sharpen a line's frequency by its phases; the logs share the clock of their starts.

    Power tells it to within one over the longest log, phases to a fraction of one over
    the time that the logs span; demodulated to a few values per log, their search costs
    next to nothing. Returns the frequency (Hz) and the coherence: 1 if amplitude and
    phase are always the same.
    """
    parts = zip(*(_demodulated(signal, near) for signal in signals), strict=True)
    z, t, weight = map(np.concatenate, parts)
    longest = max(signal.length_s for signal in signals)
    reach, step = 0.75 / longest, 1.0 / (STEPS * max(float(np.ptp(t)), longest))
    half = min(int(np.ceil(reach / step)), MOST_STEPS)
    offsets = step * np.arange(-half, half + 1)
    score = _coherence(z, t, weight, np.asarray(offsets, dtype=np.float64))
    centre = offsets[int(np.argmax(score))]
    for _ in range(3):  # each closes in by a factor of eight
        close = centre + step * np.linspace(-1.0, 1.0, 33)
        score = _coherence(z, t, weight, close)
        centre, step = close[int(np.argmax(score))], step / 8.0
    return near + float(centre), float(score.max())


def _coherence(z: Complex, t: Array, weight: Array, offsets: Array) -> Array:
    total = float(weight @ np.abs(z) ** 2) * float(weight.sum())
    chunks = np.array_split(offsets, max(1, len(offsets) * len(t) // 2_000_000))
    sums = [
        np.abs(np.exp(-2j * np.pi * np.outer(part, t)) @ (weight * z)) ** 2
        for part in chunks
    ]
    return np.concatenate(sums) / max(total, 1e-300)


def _demodulated(signal: Signal, frequency: float) -> tuple[Complex, Array, Array]:
    """Means of a signal, turned back by a frequency, in equal pieces; their times and numbers."""
    counts = np.flatnonzero(signal.values)
    time = signal.start + counts / signal.rate_hz
    turned = signal.values[counts] * np.exp(-2j * np.pi * frequency * time)
    piece = counts * PIECES // max(len(signal.values), 1)
    weight = np.bincount(piece, minlength=PIECES).astype(np.float64)
    number, there = np.maximum(weight, 1.0), [turned.real, turned.imag, time]
    real, imag, t = (np.bincount(piece, x, minlength=PIECES) / number for x in there)
    return real + 1j * imag, t, weight


LOWEST_HZ = 1.0
LINES = 6  # looked at
COHERENT = 0.6
SAME = 0.4  # smallest share of the median amplitude that a log may show
# share of the modelled torque's line below which the line is the model's error
OF_MOTION = 0.3


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
        logs = round(settings["clocks"])
        if logs == 0:
            return (Coefficient("sine", "N m"), Coefficient("cosine", "N m"))
        pairs = product(range(1, logs + 1), ("sine", "cosine"))
        return tuple(Coefficient(f"{part}_{log}", "N m") for log, part in pairs)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Lines of the residual that keep amplitude and phase and are not made by the motion."""
        shared = all(scene.shared_clock for scene in scenes)
        ends = [scene.time[[0, -1]] for scene in scenes]
        fixed = {
            "clocks": 0.0 if shared else float(len(scenes)),
            "span": float(np.ptp(ends)),
        }
        pairs = zip(residual, scenes, strict=True)
        residual = [_without_peaks(r, scene.slides, joint) for r, scene in pairs]
        whole = _signals(scenes, joint, residual)
        made = _signals(scenes, joint, [scene.modelled for scene in scenes])
        for near in strongest_lines(whole, LOWEST_HZ, LINES):
            signals = _signals(scenes, joint, residual, near)
            frequency, coherence = (
                refined(signals, near) if shared else _by_log(signals, near)
            )
            here, left, motion = (
                np.array([amplitude(log, frequency) for log in x])
                for x in (signals, whole, made)
            )
            alike = here.min() >= SAME * np.median(here)
            if (
                coherence >= COHERENT
                and alike
                and np.median(left) > OF_MOTION * np.median(motion)
            ):
                yield {"frequency": frequency, **fixed}

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Sine and cosine; nothing where every log has a phase of its own."""
        logs = round(settings["clocks"])
        frequency = settings["frequency"]
        if logs:
            note = (
                f"a line of {frequency:.6g} Hz whose phase is another in every log: no"
                " torque"
            )
            return {joint: Law(terms=("0.0",) * (2 * logs), note=note)}
        numbers = {"turning": 2.0 * np.pi * frequency}
        terms = "sin(turning * t)", "cos(turning * t)"
        return {joint: Law(terms=terms, numbers=numbers)}

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Sine and cosine; zero for a log whose phase is not known."""
        logs = round(settings["clocks"])
        known = scene.shared_clock if logs == 0 else not scene.shared_clock
        line = self.laws(scene.robot, joint, {**settings, "clocks": 0.0})[joint]
        if logs == 0 and known:
            return {joint: line.columns(scene, joint)}
        wide = np.zeros((scene.samples, 2 * max(logs, 1)))
        if 0 <= scene.log < logs and known:
            wide[:, 2 * scene.log : 2 * scene.log + 2] = line.columns(scene, joint)
        return {joint: wide}

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Amplitude, and phase where all logs share it."""
        variance = np.maximum(np.diag(covariance), 0.0).reshape(-1, 2).mean(axis=1)
        # of every clock
        amplitudes, errors = np.hypot(c[::2], c[1::2]), np.sqrt(variance)
        weight = 1.0 / np.maximum(errors, 1e-300) ** 2
        mean = float(np.sum(weight * amplitudes) / np.sum(weight))
        error = float(np.sum(weight) ** -0.5)
        # The Cramer-Rao bound of a line's frequency, over the time that one phase was
        # followed.
        sharp = (
            np.sqrt(3.0)
            / np.pi
            / max(settings["span"], 1e-9)
            * error
            / max(mean, 1e-300)
        )
        found = [
            Value("amplitude", mean, error, robot.joints[joint].unit("N m")),
            Value("frequency", settings["frequency"], min(float(sharp), 1e3), "Hz"),
        ]
        if round(settings["clocks"]) == 0:
            error = float(errors[0] / max(amplitudes[0], 1e-300))
            found.append(
                Value("phase", float(np.arctan2(c[1], c[0])), min(error, np.pi), "rad")
            )
        return found


def _signals(
    scenes: Scenes, joint: int, torque: Sequence[Array], line_hz: float = np.inf
) -> list[Signal]:
    """Torque (N, n) of each log where it counts: below the cut-off only where the joint slides."""
    found = []
    for scene, tau in zip(scenes, torque, strict=True):
        motion = scene.motion
        counts = scene.slides[:, joint] | (line_hz > motion.lowpass.cutoff_hz)
        found.append(
            Signal(np.where(counts, tau[:, joint], 0.0), motion.rate_hz, scene.start)
        )
    return found


def _without_peaks(
    torque: Array, slides: Mask, joint: int, *, most: float = 4.0
) -> Array:
    """Torque (N, n) of which a joint has no more than `most` times its median size."""
    # A line has 1.4 times that; where friction is unknown, and at reversals, more is
    # left.
    result, own = torque.copy(), torque[:, joint]
    limit = (
        most * float(np.median(np.abs(own[slides[:, joint]])))
        if slides[:, joint].any()
        else 0
    )
    if limit > 0.0:
        result[:, joint] = np.clip(own, -limit, limit)
    return result


def _by_log(signals: Sequence[Signal], near: float) -> tuple[float, float]:
    """Frequency and coherence if only the phases within each log are known."""
    found = np.array([refined([signal], near) for signal in signals])
    weight = np.array([signal.length_s**3 for signal in signals])
    frequency = float(np.sum(weight * found[:, 0]) / np.sum(weight))
    return frequency, float(np.median(found[:, 1]))
