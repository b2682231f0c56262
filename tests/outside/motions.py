"""Motions that people record: position (rad) of every joint at moments (s)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from tests.outside.arms import REACH

Array = NDArray[np.float64]
STEP_S = 1e-3


def _times(seconds: float) -> Array:
    return np.arange(0.0, seconds, STEP_S)


def trial(n: int, joint: int, posture: Array, speeds: Array) -> Array:
    """One joint to and fro at constant speeds with rounded ends, the others held: (N, n)."""
    knots, moments = [-REACH], [0.0]
    for speed in speeds:
        for side in (1.0, -1.0):
            moments.append(moments[-1] + 2.0 * REACH / speed)
            knots.append(side * REACH)
    t = _times(moments[-1])
    line = np.interp(t, moments, knots)
    width = 151  # corners of 0.15 s
    padded = np.pad(line, width // 2, mode="edge")
    q = np.tile(posture, (len(t), 1))
    q[:, joint] = np.convolve(padded, np.hanning(width) / np.hanning(width).sum(), "valid")
    return q


def multisine(n: int, rng: np.random.Generator, seconds: float) -> Array:
    """Harmonics of a tenth of a hertz with drawn phases, faded in and out."""
    t = _times(seconds)
    harmonics = np.arange(1, 9) * 0.1
    size = rng.uniform(0.3, 1.0, (n, 8)) / np.sqrt(np.arange(1, 9))
    wave = np.sin(2 * np.pi * harmonics[:, None] * t + rng.uniform(0, 6.3, (n, 8, 1)))
    q = np.einsum("jk,jkt->tj", size, wave)
    fade = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    return 0.8 * REACH * q / np.abs(q).max(axis=0) * fade[:, None]


def point_to_point(n: int, rng: np.random.Generator, seconds: float) -> Array:
    """Moves of all joints at once between drawn points, with pauses; no overshoot."""
    moments = np.cumsum(np.tile([1.2, 0.4], int(seconds / 1.6)))
    points = rng.uniform(-0.8 * REACH, 0.8 * REACH, (len(moments) // 2, n))
    knots = np.vstack([np.zeros(n), np.repeat(points, 2, axis=0)])
    return np.asarray(
        PchipInterpolator(np.concatenate([[0.0], moments]), knots)(_times(moments[-1]))
    )


def spline(n: int, rng: np.random.Generator, seconds: float) -> Array:
    """A cubic spline through drawn points at uneven times, as a program of via points gives."""
    moments = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.3, int(seconds)))])
    knots = rng.uniform(-0.6 * REACH, 0.6 * REACH, (len(moments), n))
    knots[[0, -1]] = 0.0
    return np.asarray(CubicSpline(moments, knots, bc_type="clamped")(_times(moments[-1])))
