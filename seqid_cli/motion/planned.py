"""Planned moves as time series.

A joint follows sums of sines and cosines, or strokes. Fourier moves start and stop
smoothly:

    q(t) = c + A w(t) sum_k [a_k sin(k W t) + b_k cos(k W t)],    W = 2 pi / T.

The window w rises from 0 to 1 over half a period of the highest harmonic, as 10 x^3 -
15 x^4 + 6 x^5, and falls alike, so that position, velocity and acceleration meet rest.
A stroke gets up to its speed v and back to rest in cosine ramps, v (1 - cos(pi t / r))
/ 2, of the length r = pi v / (2 a) at which their largest acceleration is a.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.params.results.plan import HARMONICS, PlannedMove, Stroke
from seqid_cli.typing import Array

COEFFICIENTS = 2 * HARMONICS
RATE_HZ = 100.0  # of the rows; controllers interpolate between them
REST_S = 0.3  # before the first stroke and after each


@dataclass(frozen=True)
class Shapes:
    """The 2 K shapes of unit coefficients and their first two derivatives, each (2 K, N)."""

    t: Array
    y: Array
    dy: Array
    ddy: Array

    @classmethod
    def over(cls, seconds: float, rate_hz: float) -> "Shapes":
        """Sample them from 0 to `seconds`, both ends included."""
        t = np.linspace(0.0, seconds, round(seconds * rate_hz) + 1)
        ramp = seconds / (2 * HARMONICS)
        up, down = np.clip(t / ramp, 0.0, 1.0), np.clip((seconds - t) / ramp, 0.0, 1.0)
        x, sign = np.minimum(up, down), np.where(up <= down, 1.0, -1.0) / ramp
        w = x**3 * (10 - 15 * x + 6 * x**2)
        dw = sign * (30 * x**2 * (1 - x) ** 2)
        ddw = 60 * x * (1 - x) * (1 - 2 * x) / ramp**2
        pace = 2 * np.pi / seconds * np.repeat(np.arange(1, HARMONICS + 1), 2)[:, None]
        lag = np.tile([0.0, np.pi / 2], HARMONICS)[:, None]
        s, ds = np.sin(pace * t + lag), pace * np.cos(pace * t + lag)
        dds = -(pace**2) * s
        return cls(t, w * s, dw * s + w * ds, ddw * s + 2 * dw * ds + w * dds)


def profile(stroke: Stroke, rate_hz: float) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration (N,) of a stroke, its end included, its start not."""
    way, v = abs(stroke.end - stroke.start), stroke.speed
    ramp = np.pi * v / (2.0 * stroke.acceleration)
    total = way / v + ramp
    t = np.minimum(np.arange(1, int(np.ceil(total * rate_hz)) + 1) / rate_hz, total)
    up, down = np.minimum(t, ramp), np.clip(t - (total - ramp), 0.0, ramp)
    pace = np.pi / ramp
    moved = v * (up / 2 - np.sin(pace * up) / (2 * pace))
    moved += v * np.clip(t - ramp, 0.0, total - 2 * ramp)
    moved += v * (down / 2 + np.sin(pace * down) / (2 * pace))
    speed = (
        v
        * np.where(t < total - ramp, 1 - np.cos(pace * up), 1 + np.cos(pace * down))
        / 2
    )
    push = v * pace / 2 * np.where(t < ramp, np.sin(pace * up), -np.sin(pace * down))
    way_sign = np.sign(stroke.end - stroke.start)
    return stroke.start + way_sign * moved, way_sign * speed, way_sign * push


def sampled(
    move: PlannedMove, names: Sequence[str], rate_hz: float
) -> tuple[Array, ...]:
    """Return times (N,) s, positions, speeds and accelerations (N, n) of a planned move."""
    own = {}
    if move.strokes:  # of one joint, each with a rest after it
        rest = round(REST_S * rate_hz)
        parts = [np.outer([move.strokes[0].start, 0.0, 0.0], np.ones(rest + 1))]
        for stroke in move.strokes:
            still = np.outer([stroke.end, 0.0, 0.0], np.ones(rest))
            parts += [np.array(profile(stroke, rate_hz)), still]
        own[move.joints[0]] = np.concatenate(parts, axis=1)
        t = np.arange(own[move.joints[0]].shape[1]) / rate_hz
    else:
        shapes = Shapes.over(move.duration_s, rate_hz)
        t, c = shapes.t, np.empty(COEFFICIENTS)
        for name, motion in move.fourier.items():
            c[0::2], c[1::2] = motion.sine, motion.cosine
            own[name] = np.array(
                [motion.centre + c @ shapes.y, c @ shapes.dy, c @ shapes.ddy]
            )
    states = np.zeros((3, len(t), len(names)))
    states[0] = [move.start[name] for name in names]
    for name, values in own.items():
        states[:, :, list(names).index(name)] = values
    return t, *states
