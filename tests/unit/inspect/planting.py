"""Changes to the columns of a log, each as some driver, logger or cable makes it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = dict[str, Array]
Plant = Callable[[Columns, np.random.Generator], None]


def nothing(columns: Columns, rng: np.random.Generator) -> None:
    pass


def scaled(name: str, factor: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name] = columns[name] * factor

    return plant


def all_scaled(suffix: str, factor: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in columns:
            if name.endswith(suffix):
                columns[name] = columns[name] * factor

    return plant


def every(names: tuple[str, ...], factor: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in names:
            columns[name] = columns[name] * factor

    return plant


def beside(joint: str, motor: str, sensor: str) -> Plant:
    """A second sensor at every joint, reversed at one."""

    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in [name for name in columns if name.endswith(motor)]:
            sign = -1.0 if name == f"{joint}{motor}" else 1.0
            columns[name.replace(motor, sensor)] = sign * columns[name]

    return plant


def constant(name: str, value: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name] = np.full_like(columns[name], value)

    return plant


def swapped(*pairs: tuple[str, str]) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for a, b in pairs:
            columns[a], columns[b] = columns[b], columns[a]

    return plant


def clipped(name: str, share: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        limit = share * np.abs(columns[name]).max()
        columns[name] = np.clip(columns[name], -limit, limit)

    return plant


def stuck(name: str, seconds: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        t = columns["t"]
        inside = (t > t[0] + 4.0) & (t < t[0] + 4.0 + seconds)
        columns[name][inside] = columns[name][inside][0]

    return plant


def frozen(name: str, samples: int) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        q = columns[name]
        slope = np.gradient(np.convolve(q, np.ones(25) / 25, "same"))
        fast = int(np.argmax(np.abs(slope[100:-100])))
        q[fast + 100 : fast + 100 + samples] = q[fast + 100]

    return plant


def spikes(name: str, size: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        at = rng.choice(len(columns[name]) - 200, 4, replace=False) + 100
        columns[name][at] += size * np.array([1.0, -1.0, 1.0, -1.0])

    return plant


def jump(name: str, size: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name][len(columns[name]) // 2 :] += size

    return plant


def wrapped(name: str) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        start = np.median(columns[name])
        columns[name] = (columns[name] - start) % (2 * np.pi) + start

    return plant


def quantised(name: str, step: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name] = np.round(columns[name] / step) * step

    return plant


def held(name: str, size: int) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name] = columns[name][np.arange(len(columns[name])) // size * size]

    return plant


def missing(name: str, share: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        inside = rng.choice(len(columns[name]) - 20, int(share * len(columns[name]))) + 10
        columns[name][inside] = np.nan

    return plant


def cut(start: float, stop: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        t = columns["t"] - columns["t"][0]
        kept = (t < start) | (t > stop)
        for name in columns:
            columns[name] = columns[name][kept]

    return plant


def jittered(columns: Columns, rng: np.random.Generator) -> None:
    t = columns["t"]
    kept = np.sort(rng.choice(len(t), int(0.6 * len(t)), replace=False))
    for name in columns:
        columns[name] = columns[name][kept]
    # Bursts of stamps, as of a buffered reader: in order, but far from even.
    steps = np.diff(t[kept]).mean() * rng.exponential(1.0, len(kept)).clip(0.01, 4.0)
    columns["t"] = t[0] + np.cumsum(steps)


def exchanged_rows(columns: Columns, rng: np.random.Generator) -> None:
    order = np.arange(len(columns["t"]))
    for at in (300, 900, 1500):
        order[[at, at + 1]] = order[[at + 1, at]]
    for name in columns:
        columns[name] = columns[name][order]


def repeated_rows(columns: Columns, rng: np.random.Generator) -> None:
    order = np.sort(np.concatenate([np.arange(len(columns["t"])), [200, 700, 701, 702]]))
    for name in columns:
        columns[name] = columns[name][order]


def delayed(prefix: str, samples: int) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in columns:
            if name.startswith(prefix):
                columns[name] = np.roll(columns[name], samples)

    return plant


def renamed(old: str, new: str) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in list(columns):
            if name.startswith(old):
                columns[new + name.removeprefix(old)] = columns.pop(name)

    return plant


def negated(*names: str) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in names:
            columns[name] = -columns[name]

    return plant


def shifted(name: str, offset: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns[name] = columns[name] + offset

    return plant


def without(suffix: str) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in [name for name in columns if name.endswith(suffix)]:
            del columns[name]

    return plant


def commanded_gravity(columns: Columns, rng: np.random.Generator) -> None:
    q = columns["elbow.position"]
    columns["elbow.current"] = 0.4 * np.cos(q) + 0.1


def ending(old: str, new: str) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in [name for name in columns if name.endswith(old)]:
            columns[name.removesuffix(old) + new] = columns.pop(name)

    return plant


def beginning(prefix: str, factor: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in columns:
            if name.startswith(prefix):
                columns[name] = columns[name] * factor

    return plant


def both(first: Plant, second: Plant) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        first(columns, rng)
        second(columns, rng)

    return plant
