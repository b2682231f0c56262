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

from seqid_cli.params.results.plan import (
    HARMONICS,
    ChirpMotion,
    PlannedMove,
    Stroke,
)
from seqid_cli.typing import Array

COEFFICIENTS = 2 * HARMONICS
RATE_HZ = 100.0  # of the rows; controllers interpolate between them
REST_S = 0.3  # before the first stroke and after each
PER_PERIOD = 10.0  # rows of a wave, for controllers that interpolate between them


@dataclass(frozen=True)
class Shapes:
    """The 2 K shapes of unit coefficients and their two derivatives, each (2 K, N)."""

    t: Array
    y: Array
    dy: Array
    ddy: Array

    @classmethod
    def over(cls, seconds: float, rate_hz: float) -> "Shapes":
        """Sample the shapes from 0 to `seconds`, both ends included."""
        t = np.linspace(0.0, seconds, round(seconds * rate_hz) + 1)

        # The window w over x, from 0 to 1 in the ramps at both ends.
        ramp = seconds / (2 * HARMONICS)
        rising = np.clip(t / ramp, 0.0, 1.0)
        falling = np.clip((seconds - t) / ramp, 0.0, 1.0)
        x = np.minimum(rising, falling)
        dx = np.where(rising <= falling, 1.0, -1.0) / ramp
        w = x**3 * (10 - 15 * x + 6 * x**2)
        dw = dx * (30 * x**2 * (1 - x) ** 2)
        ddw = 60 * x * (1 - x) * (1 - 2 * x) / ramp**2

        # s: sine and cosine of every harmonic, one after the other.
        harmonic = np.repeat(np.arange(1, HARMONICS + 1), 2)
        pace = 2 * np.pi / seconds * harmonic[:, None]
        phase = np.tile([0.0, np.pi / 2], HARMONICS)[:, None]
        s = np.sin(pace * t + phase)
        ds = pace * np.cos(pace * t + phase)
        dds = -(pace**2) * s
        return cls(
            t=t,
            y=w * s,
            dy=dw * s + w * ds,
            ddy=ddw * s + 2 * dw * ds + w * dds,
        )


def profile(stroke: Stroke, rate_hz: float) -> tuple[Array, Array, Array]:
    """Compute position, speed and acceleration (N,) of a stroke.

    Its end is included, its start is not.
    """
    distance = abs(stroke.end - stroke.start)
    direction = np.sign(stroke.end - stroke.start)
    v = stroke.speed
    ramp = np.pi * v / (2.0 * stroke.acceleration)
    duration = distance / v + ramp
    times = np.arange(1, int(np.ceil(duration * rate_hz)) + 1) / rate_hz
    t = np.minimum(times, duration)

    # Times within the first ramp, at full speed, and within the second ramp.
    up = np.minimum(t, ramp)
    cruise = np.clip(t - ramp, 0.0, duration - 2 * ramp)
    down = np.clip(t - (duration - ramp), 0.0, ramp)
    pace = np.pi / ramp
    travelled = v * (up / 2 - np.sin(pace * up) / (2 * pace))
    travelled += v * cruise
    travelled += v * (down / 2 + np.sin(pace * down) / (2 * pace))

    slows = t >= duration - ramp
    speed = v * np.where(slows, 1 + np.cos(pace * down), 1 - np.cos(pace * up)) / 2
    speeds_up = t < ramp
    acceleration = (
        v * pace / 2 * np.where(speeds_up, np.sin(pace * up), -np.sin(pace * down))
    )
    position = stroke.start + direction * travelled
    return position, direction * speed, direction * acceleration


def waves(chirp: ChirpMotion, t: Array) -> Array:
    """Compute position, speed and acceleration (3, N) of a chirp at even times."""
    seconds = float(t[-1] - t[0])
    growth = np.log(chirp.highest_hz / chirp.lowest_hz) / seconds
    f = chirp.lowest_hz * np.exp(growth * t)
    phase = 2.0 * np.pi * (f - chirp.lowest_hz) / growth
    # Windows and amplitudes change slowly: their derivatives by differences do.
    ramp = seconds / (2 * HARMONICS)
    x = np.clip(np.minimum(t / ramp, (seconds - t) / ramp), 0.0, 1.0)
    window = x**3 * (10 - 15 * x + 6 * x**2)
    A = window * chirp.amplitude / (1.0 + (f / chirp.corner_hz) ** 2)
    dA = np.gradient(A, t)
    ddA = np.gradient(dA, t)
    pace = 2.0 * np.pi * f
    y = np.sin(phase)
    dy = pace * np.cos(phase)
    ddy = growth * dy - pace**2 * y
    return np.array(
        [chirp.centre + A * y, dA * y + A * dy, ddA * y + 2.0 * dA * dy + A * ddy]
    )


def rows_per_second(move: PlannedMove, usual_hz: float) -> float:
    """Return the rows per second of a move's file: the usual ones, or more."""
    highest_hz = max((each.highest_hz for each in move.chirp.values()), default=0.0)
    return max(usual_hz, PER_PERIOD * highest_hz)


def sampled(
    move: PlannedMove, names: Sequence[str], rate_hz: float
) -> tuple[Array, ...]:
    """Sample a planned move.

    Parameters
    ----------
    move : PlannedMove
    names : sequence of str
        The n joints, in the order of the result's columns.
    rate_hz : float

    Returns
    -------
    tuple of Array
        Times (N,) s, positions, speeds and accelerations (N, n) [rad; m for slides].
    """
    # Of each joint that moves: position, speed, acceleration (3, N).
    by_joint = {}
    if move.strokes:
        joint = move.joints[0]
        by_joint[joint] = _strokes(move, rate_hz)
        t = np.arange(by_joint[joint].shape[1]) / rate_hz
    else:
        shapes = Shapes.over(move.duration_s, rate_hz)
        t = shapes.t
        for name, chirp in move.chirp.items():
            by_joint[name] = waves(chirp, t)
        for name, motion in move.fourier.items():
            c = np.empty(COEFFICIENTS)
            c[0::2] = motion.sine
            c[1::2] = motion.cosine
            by_joint[name] = np.array(
                [motion.centre + c @ shapes.y, c @ shapes.dy, c @ shapes.ddy]
            )

    states = np.zeros((3, len(t), len(names)))
    states[0] = [move.start[name] for name in names]
    for name, state in by_joint.items():
        states[:, :, list(names).index(name)] = state
    q, dq, ddq = states
    return t, q, dq, ddq


def _strokes(move: PlannedMove, rate_hz: float) -> Array:
    """Sample the strokes (3, N) of a move of one joint, a rest after each."""
    n_rest = round(REST_S * rate_hz)
    first = move.strokes[0].start
    parts = [np.outer([first, 0.0, 0.0], np.ones(n_rest + 1))]
    for stroke in move.strokes:
        parts.append(np.array(profile(stroke, rate_hz)))
        parts.append(np.outer([stroke.end, 0.0, 0.0], np.ones(n_rest)))
    return np.concatenate(parts, axis=1)
