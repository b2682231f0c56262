"""Motions that people record: position (rad) of every joint at moments (s)."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from tests import Array
from tests.studies.outside.arms import Arm
from tests.studies.outside.robotfiles import STEP_S

REST_S = 0.4  # at the start and the end of every log


def _times(seconds: float) -> Array:
    return np.arange(0.0, seconds, STEP_S)


def _rounded(line: Array, width: int) -> Array:
    """A line (N,) with rests before and after it, and corners of `width` samples."""
    window = np.hanning(width) / np.hanning(width).sum()
    rested = np.pad(line, round(REST_S / STEP_S) + width // 2, mode="edge")
    return np.asarray(np.convolve(rested, window, "valid"))


def fitted(arm: Arm, unit: Array) -> Array:
    """Waves (N, n) of at most 1, as positions that keep the joints' ranges and
    speeds.
    """
    links = arm.links[: arm.n]
    fast = np.abs(np.diff(unit, axis=0)).max(axis=0) / STEP_S
    limits = np.array([link.speed for link in links])
    size = np.minimum([link.reach for link in links], limits / np.maximum(fast, 1e-9))
    return np.array([link.middle for link in links]) + size * unit


def trial(arm: Arm, joint: int, posture: Array, speeds: Array) -> Array:
    """One joint to and fro at constant speeds (shares of its limit), the others held:
    (N, n).
    """
    link = arm.links[joint]
    moments = np.cumsum([0.0, *np.repeat(2.0 / (speeds * link.speed / link.reach), 2)])
    knots = np.where(np.arange(len(moments)) % 2, 1.0, -1.0)
    line = _rounded(np.interp(_times(moments[-1]), moments, knots), 301)
    middles, reaches = (
        np.array([getattr(x, k) for x in arm.links]) for k in ("middle", "reach")
    )
    q = np.tile(
        (middles + reaches * np.resize(posture, len(arm.links)))[: arm.n],
        (len(line), 1),
    )
    q[:, joint] = link.middle + link.reach * line
    return q


def multisine(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """Harmonics of a tenth of a hertz with drawn phases, faded in and out."""
    t, k = _times(seconds), np.arange(1, 9)
    size = rng.uniform(0.3, 1.0, (arm.n, 8)) / np.sqrt(k)
    wave = np.sin(
        2 * np.pi * (k * 0.1)[:, None] * t + rng.uniform(0, 6.3, (arm.n, 8, 1))
    )
    q = np.einsum("jk,jkt->tj", size, wave)
    fade = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    return fitted(arm, q / np.abs(q).max(axis=0) * fade[:, None])


def excitation(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """A Fourier series of five harmonics of one period of 4 to 8 s, again and again, as
    identification asks for; faded in and out.
    """
    t, k = _times(seconds), np.arange(1, 6)
    period = float(rng.uniform(4.0, 8.0))
    size = rng.uniform(0.3, 1.0, (arm.n, 5)) / np.sqrt(k)
    angle = rng.uniform(0.0, 6.3, (arm.n, 5, 1))
    wave = np.sin(2 * np.pi * (k / period)[:, None] * t + angle)
    q = np.einsum("jk,jkt->tj", size, wave)
    fade = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    return fitted(arm, q / np.abs(q).max(axis=0) * fade[:, None])


def points(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """Moves of all joints at once between drawn points, with pauses; no overshoot."""
    moments = np.cumsum(np.tile([1.2, 0.4], int(seconds / 1.6)))
    goals = rng.uniform(-0.9, 0.9, (len(moments) // 2, arm.n))
    knots = np.vstack([np.zeros((2, arm.n)), np.repeat(goals, 2, axis=0)])
    line = PchipInterpolator(np.concatenate([[0.0, REST_S], REST_S + moments]), knots)
    return fitted(arm, np.asarray(line(_times(moments[-1]))))


def spline(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """A cubic spline through drawn points at uneven times, as a program of via points
    gives.
    """
    moments = np.cumsum([0.0, *rng.uniform(0.5, 1.3, int(1.2 * seconds))])
    moments = moments[moments <= seconds]
    knots = rng.uniform(-0.7, 0.7, (len(moments), arm.n))
    knots[[0, -1]] = 0.0
    line = np.asarray(
        CubicSpline(moments, knots, bc_type="clamped")(_times(moments[-1]))
    )
    return fitted(arm, line / np.maximum(1.0, np.abs(line).max(axis=0)))


def hand(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """Tugs of a hand: one or two joints at a time, uneven, with a tremor, and rests
    between.
    """
    t = _times(seconds)
    q, at, clock = np.zeros((len(t), arm.n)), np.zeros(arm.n), 0.0
    while clock < seconds:
        lasts, rests = float(rng.uniform(0.2, 1.2)), float(rng.uniform(0.0, 0.5))
        goal = at.copy()
        moved = rng.permutation(arm.n)[: int(rng.integers(1, 3))]
        goal[moved] = rng.uniform(-0.9, 0.9, len(moved))
        way = np.clip((t - clock) / lasts, 0.0, 1.0) ** float(rng.uniform(0.8, 1.6))
        tremor = (
            0.01
            * np.sin(2 * np.pi * float(rng.uniform(6, 9)) * t)
            * np.sin(np.pi * way)
        )
        now = t >= clock
        q[now] = (at + np.outer(way, goal - at) + np.outer(tremor, goal != at))[now]
        at, clock = goal, clock + lasts + rests
    return fitted(arm, np.column_stack([_rounded(line, 121) for line in q.T]))


def walk(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """A walk through via points as a program at full speed gives it: a quarter further
    than the friction trials reach, and up to 1.4 of the speed that they call the limit.
    """
    links = arm.links[: arm.n]
    knots = rng.uniform(-1.2, 1.2, (int(2.0 * seconds), arm.n))
    knots[0] = 0.0
    limits = np.array([link.speed / link.reach for link in links])
    paces = rng.uniform(0.4, 0.9, (len(knots) - 1, 1)) * limits
    lasts = np.max(np.abs(np.diff(knots, axis=0)) / paces, axis=1)
    moments = np.cumsum([0.0, *np.maximum(lasts, 0.25)])
    line = CubicSpline(moments, knots, bc_type="clamped")
    # As fast as the fastest moment allows.
    t = _times(moments[-1])
    fastest = np.max(np.abs(line(t, 1)) / limits)
    pace = float(rng.uniform(1.1, 1.4)) / fastest
    walked = np.asarray(line(pace * _times(min(seconds, moments[-1] / pace))))
    # It comes to rest where it is, within a second.
    fade = np.minimum((len(walked) - np.arange(len(walked))) * STEP_S, 1.0)
    steps = (
        np.diff(walked, axis=0, prepend=walked[:1])
        * (fade**3 * (10 - 15 * fade + 6 * fade**2))[:, None]
    )
    units = walked[0] + np.cumsum(steps, axis=0)
    units *= np.minimum(1.0, 1.25 / np.abs(units).max(axis=0))
    middles, reaches = (
        np.array([getattr(link, k) for link in links]) for k in ("middle", "reach")
    )
    return middles + reaches * units


MOTIONS: Mapping[str, Callable[[Arm, np.random.Generator, float], Array]] = {
    motion.__name__: motion for motion in (multisine, points, spline, hand)
}
