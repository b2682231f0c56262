"""Reference motions at the control rate: trapezoids, joint pairs, Fourier series,
postures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests import Array


@dataclass(frozen=True)
class Reference:
    """Wanted motion: q, dq, ddq (N, n) in rad and s, one row every 1/rate_hz s."""

    q: Array
    dq: Array
    ddq: Array
    rate_hz: float

    @property
    def duration(self) -> float:
        return len(self.q) / self.rate_hz


# position, velocity, acceleration of one joint, (N,) each
Profile = tuple[Array, Array, Array]


def join(parts: Sequence[Reference]) -> Reference:
    series = zip(*((p.q, p.dq, p.ddq) for p in parts), strict=True)
    return Reference(*map(np.concatenate, series), parts[0].rate_hz)


def hold(q: Array, seconds: float, rate_hz: float) -> Reference:
    count = round(seconds * rate_hz)
    return Reference(np.tile(q, (count, 1)), *np.zeros((2, count, len(q))), rate_hz)


def trapezoid(
    start: float, end: float, speed: float, accel: float, rate_hz: float
) -> Profile:
    """Trapezoidal velocity from rest to rest; a triangle where the way is too short for
    `speed`.
    """
    way = abs(end - start)
    top = min(speed, np.sqrt(way * accel))
    if way == 0.0:
        return np.full(1, start), np.zeros(1), np.zeros(1)
    ramp, total = top / accel, way / top + top / accel
    t = np.minimum(np.arange(1, int(np.ceil(total * rate_hz)) + 1) / rate_hz, total)
    up, down = np.minimum(t, ramp), np.maximum(t - (total - ramp), 0.0)
    flat, sign = t - up - down, np.sign(end - start)
    speed_now = accel * (up - down)
    moved = 0.5 * accel * up**2 + top * flat + top * down - 0.5 * accel * down**2
    push = np.where(t < ramp, accel, np.where(t > total - ramp, -accel, 0.0))
    speed_now[-1] = push[-1] = 0.0
    moved[-1] = way
    return start + sign * moved, sign * speed_now, sign * push


def trapezoids(
    here: Array, there: Array, speed: Array, accel: Array, rate_hz: float
) -> Reference:
    """All joints from one posture to the next, every one by its own trapezoid, all
    (n,).
    """
    moves = np.column_stack([here, there, speed, accel]).tolist()
    return side_by_side([trapezoid(*move, rate_hz) for move in moves], rate_hz)


def sweeps(
    home: Array,
    joint: int,
    span: tuple[float, float],
    speeds: Sequence[float],
    accel: float,
    *,
    rate_hz: float,
    dwell: float = 0.25,
) -> Reference:
    """Forward and backward over `span` rad at each of `speeds` rad/s, `dwell` s of rest
    between.
    """
    start, end = home.copy(), home.copy()
    start[joint], end[joint] = span
    parts = [hold(start, 2 * dwell, rate_hz)]
    for speed in speeds:
        for way, rest in ((span, end), (span[::-1], start)):
            profile = trapezoid(*way, speed, accel, rate_hz)
            parts += [
                together(home, {joint: profile}, rate_hz),
                hold(rest, dwell, rate_hz),
            ]
    return join(parts)


def zigzag(
    rng: np.random.Generator,
    span: tuple[float, float],
    speed: float,
    accel: float,
    seconds: float,
    rate_hz: float,
) -> Profile:
    """Trapezoids of varied length, speed and acceleration between points drawn from
    `span`.
    """
    low, high = span
    here, count, parts = 0.5 * (low + high), 0, list[Profile]()
    while count < seconds * rate_hz:
        side = low if here > 0.5 * (low + high) else high
        there = float(side + (here - side) * 0.6 * rng.random())
        pace, push = speed * rng.uniform(0.5, 1.0), accel * rng.uniform(0.5, 1.0)
        parts.append(trapezoid(here, there, pace, push, rate_hz))
        count += len(parts[-1][0])
        here = there
    return tuple(map(np.concatenate, zip(*parts, strict=True)))


def together(home: Array, moving: dict[int, Profile], rate_hz: float) -> Reference:
    """Several joints at once, each by its own profile;
    the others stay at `home` (n,).
    """
    rest = [(np.full(1, x), np.zeros(1), np.zeros(1)) for x in home]
    return side_by_side([moving.get(i, rest[i]) for i in range(len(home))], rate_hz)


def side_by_side(profiles: Sequence[Profile], rate_hz: float) -> Reference:
    """Joints start together; those that arrive first wait."""
    count = max(len(p[0]) for p in profiles)
    columns = [
        np.column_stack([np.pad(x, (0, count - len(x)), mode="edge") for x in series])
        for series in zip(*profiles, strict=True)
    ]
    return Reference(*columns, rate_hz)


def point_to_point(
    rng: np.random.Generator,
    *limits: Array,
    points: int,
    rate_hz: float,
    dwell: float = 0.3,
) -> Reference:
    """Straight joint moves between random postures; limits as in `fourier`."""
    low, high, speed, accel = limits
    here = 0.5 * (low + high)
    parts = [hold(here, dwell, rate_hz)]
    for _ in range(points):
        before, here = here, rng.uniform(low, high)
        parts += [
            trapezoids(before, here, speed, accel, rate_hz),
            hold(here, dwell, rate_hz),
        ]
    return join(parts)


def fourier(
    rng: np.random.Generator,
    *limits: Array,
    seconds: float,
    harmonics: int,
    rate_hz: float,
) -> Reference:
    """Random Fourier series that starts and ends at rest and stays inside the limits.

    `limits` (n,) are the lowest and the highest position, speed, acceleration; each
    joint is scaled until it reaches the first of them.
    """
    t, k = np.arange(round(seconds * rate_hz)) / rate_hz, np.arange(1, harmonics + 1)
    base = 2.0 * np.pi / seconds
    weight = rng.standard_normal((2, harmonics, len(limits[0]))) / k[None, :, None]
    q, dq, ddq = _series(weight, base * np.outer(t, k), (base * k)[:, None])
    return _scaled(
        _windowed(t, seconds, (q - q.mean(axis=0), dq, ddq)), limits, rate_hz
    )


def periodic(
    rng: np.random.Generator,
    *limits: Array,
    period: float,
    periods: int,
    harmonics: int,
    rate_hz: float,
    fade: float = 1.0,
) -> Reference:
    """Random Fourier series over whole periods between fades of `fade` s from and to
    rest.

    `period` s is a whole number of samples; limits as in `fourier`. The periods begin
    `fade` s after the first row and repeat to the last bit.
    """
    count, edge = round(period * rate_hz), round(fade * rate_hz)
    k = np.arange(1, harmonics + 1)
    weight = (
        rng.standard_normal((2, harmonics, len(limits[0]))) / k[None, :, None] ** 1.5
    )
    angle = 2.0 * np.pi / count * np.outer(np.arange(count), k)
    q, dq, ddq = _series(weight, angle, (2.0 * np.pi / period * k)[:, None])
    rows = np.arange(-edge, periods * count + edge) % count
    t, total = np.arange(len(rows)) / rate_hz, periods * period + 2.0 * fade
    return _scaled(
        _windowed(t, total, (q[rows], dq[rows], ddq[rows]), fade), limits, rate_hz
    )


def _series(weight: Array, angle: Array, rate: Array) -> Profile:
    """Sines and cosines of weights (2, K, n) at angles (N, K), K rates rad/s; and
    derivatives.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    return (
        sine @ weight[0] + cosine @ weight[1],
        cosine @ (rate * weight[0]) - sine @ (rate * weight[1]),
        -sine @ (rate**2 * weight[0]) - cosine @ (rate**2 * weight[1]),
    )


def _scaled(motion: Profile, limits: Sequence[Array], rate_hz: float) -> Reference:
    """Motion about the middle of the ranges,
    each joint up to the first of its limits.
    """
    low, high, speed, accel = limits
    sizes = zip((0.5 * (high - low), speed, accel), motion, strict=True)
    scale = np.min([limit / np.abs(x).max(0) for limit, x in sizes], axis=0)
    q, dq, ddq = motion
    return Reference(0.5 * (low + high) + scale * q, scale * dq, scale * ddq, rate_hz)


def _windowed(t: Array, seconds: float, motion: Profile, fade: float = 1.0) -> Profile:
    """Fade in and out over `fade` s with a smooth step, derivatives by the product
    rule.
    """
    q, dq, ddq = motion
    fade = min(fade, 0.25 * seconds)
    s = np.clip(np.minimum(t, seconds - t) / fade, 0.0, 1.0)
    side = np.where(t < 0.5 * seconds, 1.0, -1.0) / fade
    w = (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
    dw = (30 * s**2 * (1 - s) ** 2 * side)[:, None]
    ddw = (60 * s * (1 - s) * (1 - 2 * s) * side**2)[:, None]
    return w * q, dw * q + w * dq, ddw * q + 2 * dw * dq + w * ddq
