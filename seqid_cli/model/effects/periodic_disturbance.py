"""A line at a fixed frequency of time: the mains, a fan, a pump.

    tau = A sin(2 pi f t + p) = a sin(2 pi f t) + b cos(2 pi f t)

A [N m], f [Hz]. Where the logs share a clock, t counts from the first log and one phase p serves
all; the frequency is then known to a small part of one over the time that the logs span. Otherwise
t counts from each log's start and every log has a phase of its own (`clocks` says how many): such
a line is known to be there, but cannot be predicted for another log.

A line is not taken for a disturbance if the motion makes it: if it is missing in some of the logs,
if its phase wanders, or if the modelled torque has a line there of comparable size.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Grid, Setting, Settings
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.model.effects.spectral_lines import Signal, amplitude, refined, strongest_lines
from seqid_cli.model.effects.units import Value
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

LOWEST_HZ = 1.0
LINES = 6  # looked at
COHERENT = 0.6
SAME = 0.4  # smallest share of the median amplitude that a log may show
OF_MOTION = 0.3  # share of the modelled torque's line below which the line is the model's error


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
        "the same motion at two speeds: a disturbance keeps its frequency, what the motion makes "
        "moves with the speed; a motion whose period is no multiple of the disturbance's"
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
        fixed = {"clocks": 0.0 if shared else float(len(scenes)), "span": float(np.ptp(ends))}
        pairs = zip(residual, scenes, strict=True)
        residual = [_without_peaks(r, scene.slides, joint) for r, scene in pairs]
        whole = _signals(scenes, joint, residual)
        made = _signals(scenes, joint, [scene.modelled for scene in scenes])
        for near in strongest_lines(whole, LOWEST_HZ, LINES):
            signals = _signals(scenes, joint, residual, near)
            frequency, coherence = refined(signals, near) if shared else _by_log(signals, near)
            here, left, motion = (
                np.array([amplitude(log, frequency) for log in x]) for x in (signals, whole, made)
            )
            alike = here.min() >= SAME * np.median(here)
            if coherence >= COHERENT and alike and np.median(left) > OF_MOTION * np.median(motion):
                yield {"frequency": frequency, **fixed}

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Sine and cosine; zero for a log whose phase is not known."""
        logs = round(settings["clocks"])
        phase = 2.0 * np.pi * settings["frequency"] * scene.time
        line = np.column_stack([np.sin(phase), np.cos(phase)])
        if logs == 0:
            return {joint: line if scene.shared_clock else np.zeros_like(line)}
        wide = np.zeros((scene.samples, 2 * logs))
        if 0 <= scene.log < logs and not scene.shared_clock:
            wide[:, 2 * scene.log : 2 * scene.log + 2] = line
        return {joint: wide}

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Amplitude, and phase where all logs share it."""
        variance = np.maximum(np.diag(covariance), 0.0).reshape(-1, 2).mean(axis=1)
        amplitudes, errors = np.hypot(c[::2], c[1::2]), np.sqrt(variance)  # of every clock
        weight = 1.0 / np.maximum(errors, 1e-300) ** 2
        mean = float(np.sum(weight * amplitudes) / np.sum(weight))
        error = float(np.sum(weight) ** -0.5)
        # The Cramer-Rao bound of a line's frequency, over the time that one phase was followed.
        sharp = np.sqrt(3.0) / np.pi / max(settings["span"], 1e-9) * error / max(mean, 1e-300)
        found = [
            Value("amplitude", mean, error, robot.joints[joint].unit("N m")),
            Value("frequency", settings["frequency"], min(float(sharp), 1e3), "Hz"),
        ]
        if round(settings["clocks"]) == 0:
            error = float(errors[0] / max(amplitudes[0], 1e-300))
            found.append(Value("phase", float(np.arctan2(c[1], c[0])), min(error, np.pi), "rad"))
        return found


def _signals(
    scenes: Scenes, joint: int, torque: Sequence[Array], line_hz: float = np.inf
) -> list[Signal]:
    """Torque (N, n) of each log where it counts: below the cut-off only where the joint slides."""
    found = []
    for scene, tau in zip(scenes, torque, strict=True):
        motion = scene.motion
        counts = scene.slides[:, joint] | (line_hz > motion.lowpass.cutoff_hz)
        found.append(Signal(np.where(counts, tau[:, joint], 0.0), motion.rate_hz, scene.start))
    return found


def _without_peaks(torque: Array, slides: Mask, joint: int, *, most: float = 4.0) -> Array:
    """Torque (N, n) of which a joint has no more than `most` times its median size."""
    # A line has 1.4 times that; where friction is unknown, and at reversals, more is left.
    result, own = torque.copy(), torque[:, joint]
    limit = most * float(np.median(np.abs(own[slides[:, joint]]))) if slides[:, joint].any() else 0
    if limit > 0.0:
        result[:, joint] = np.clip(own, -limit, limit)
    return result


def _by_log(signals: Sequence[Signal], near: float) -> tuple[float, float]:
    """Frequency and coherence if only the phases within each log are known."""
    found = np.array([refined([signal], near) for signal in signals])
    weight = np.array([signal.length_s**3 for signal in signals])
    frequency = float(np.sum(weight * found[:, 0]) / np.sum(weight))
    return frequency, float(np.median(found[:, 1]))
