"""Changes to the columns of a log, each as some driver, logger or cable makes it."""

from collections.abc import Callable
from fnmatch import fnmatch
from typing import Concatenate, ParamSpec

import numpy as np

from tests import Array

Columns = dict[str, Array]
Plant = Callable[[Columns, np.random.Generator], None]
P = ParamSpec("P")


def planter(
    change: Callable[Concatenate[Columns, np.random.Generator, P], None],
) -> Callable[P, Plant]:
    """Make plants of a change to columns that takes more than these."""
    return lambda *args, **named: (
        lambda columns, rng: change(columns, rng, *args, **named)
    )


@planter
def changed(
    columns: Columns,
    _: np.random.Generator,
    pattern: str,
    change: Callable[[Array], Array],
) -> None:
    columns.update(
        {n: change(values) for n, values in columns.items() if fnmatch(n, pattern)}
    )


@planter
def both(columns: Columns, rng: np.random.Generator, *plants: Plant) -> None:
    for plant in plants:
        plant(columns, rng)


nothing = both()


def times(factor: float, *patterns: str) -> Plant:
    return both(*(changed(pattern, lambda x: x * factor) for pattern in patterns))


def negated(*patterns: str) -> Plant:
    return times(-1.0, *patterns)


def shifted(pattern: str, offset: float) -> Plant:
    return changed(pattern, lambda x: x + offset)


def constant(pattern: str, value: float) -> Plant:
    return changed(pattern, lambda x: np.full_like(x, value))


def quantised(pattern: str, step: float) -> Plant:
    return changed(pattern, lambda x: np.round(x / step) * step)


def held(pattern: str, size: int) -> Plant:
    return changed(pattern, lambda x: x[np.arange(len(x)) // size * size])


def clipped(pattern: str, share: float) -> Plant:
    return changed(
        pattern, lambda x: np.clip(x, -share * abs(x).max(), share * abs(x).max())
    )


def wrapped(pattern: str) -> Plant:
    return changed(pattern, lambda x: (x - np.median(x)) % (2 * np.pi) + np.median(x))


def delayed(pattern: str, samples: int) -> Plant:
    return changed(pattern, lambda x: np.roll(x, samples))


def drifting(pattern: str, rate: float) -> Plant:
    """Readings of a clock that gains `rate`, and is right in the middle of the log."""

    def change(x: Array) -> Array:
        row = np.arange(len(x))
        middle = 0.5 * len(x)
        return np.asarray(np.interp(middle + (row - middle) / (1.0 + rate), row, x))

    return changed(pattern, change)


def jump(pattern: str, size: float) -> Plant:
    return changed(pattern, lambda x: x + size * (np.arange(len(x)) >= len(x) // 2))


def frozen(pattern: str, samples: int) -> Plant:
    def stop(x: Array) -> Array:
        slope = np.gradient(np.convolve(x, np.ones(25) / 25, "same"))
        fast = int(np.argmax(np.abs(slope[100:-100]))) + 100
        return np.concatenate(
            [x[:fast], np.full(samples, x[fast]), x[fast + samples :]]
        )

    return changed(pattern, stop)


@planter
def beside(
    columns: Columns, _: np.random.Generator, joint: str, motor: str, sensor: str
) -> None:
    """A second sensor at every joint, reversed at one."""
    for name in [name for name in columns if name.endswith(motor)]:
        sign = -1.0 if name == f"{joint}{motor}" else 1.0
        columns[name.replace(motor, sensor)] = sign * columns[name]


@planter
def swapped(columns: Columns, _: np.random.Generator, *pairs: tuple[str, str]) -> None:
    for a, b in pairs:
        columns[a], columns[b] = columns[b], columns[a]


@planter
def stuck(columns: Columns, _: np.random.Generator, name: str, seconds: float) -> None:
    t = columns["t"] - columns["t"][0]
    inside = (t > 4.0) & (t < 4.0 + seconds)
    columns[name][inside] = columns[name][inside][0]


@planter
def spikes(columns: Columns, rng: np.random.Generator, name: str, size: float) -> None:
    at = rng.choice(len(columns[name]) - 200, 4, replace=False) + 100
    columns[name][at] += size * np.array([1.0, -1.0, 1.0, -1.0])


@planter
def missing(
    columns: Columns, rng: np.random.Generator, name: str, share: float
) -> None:
    inside = rng.choice(len(columns[name]) - 20, int(share * len(columns[name]))) + 10
    columns[name][inside] = np.nan


@planter
def cut(columns: Columns, rng: np.random.Generator, start: float, stop: float) -> None:
    t = columns["t"] - columns["t"][0]
    changed("*", lambda x: x[(t < start) | (t > stop)])(columns, rng)


def jittered(columns: Columns, rng: np.random.Generator) -> None:
    t = columns["t"]
    kept = np.sort(rng.choice(len(t), int(0.6 * len(t)), replace=False))
    changed("*", lambda x: x[kept])(columns, rng)
    # Bursts of stamps, as of a buffered reader: in order, but far from even.
    steps = np.diff(columns["t"]).mean() * rng.exponential(1.0, len(kept)).clip(
        0.01, 4.0
    )
    columns["t"] = t[0] + np.cumsum(steps)


def exchanged(x: Array) -> Array:
    order = np.arange(len(x))
    order[[300, 301, 900, 901, 1500, 1501]] = [301, 300, 901, 900, 1501, 1500]
    return x[order]


exchanged_rows = changed("*", exchanged)
repeated_rows = changed(
    "*", lambda x: np.insert(x, [200, 700, 701, 702], x[[200, 700, 701, 702]])
)


@planter
def renamed(
    columns: Columns, _: np.random.Generator, old: str, new: str | None
) -> None:
    for name in [*columns]:
        values = columns.pop(name)
        if new or old not in name:
            columns[name.replace(old, new or "")] = values


def commanded_gravity(columns: Columns, _: np.random.Generator) -> None:
    columns["elbow.current"] = 0.4 * np.cos(columns["elbow.position"]) + 0.1
