"""Changes to the columns of a log, each as some driver, logger or cable makes it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests import Array

Columns = dict[str, Array]
Plant = Callable[[Columns, np.random.Generator], None]


def nothing(columns: Columns, rng: np.random.Generator) -> None:
    pass


def those(chosen: Callable[[str], bool], change: Callable[[Array], Array]) -> Plant:
    """The columns of some names, each changed alike."""

    def plant(columns: Columns, rng: np.random.Generator) -> None:
        columns.update({n: change(values) for n, values in columns.items() if chosen(n)})

    return plant


def only(name: str, change: Callable[[Array], Array]) -> Plant:
    return those(name.__eq__, change)


def scaled(name: str, factor: float) -> Plant:
    return only(name, lambda x: x * factor)


def shifted(name: str, offset: float) -> Plant:
    return only(name, lambda x: x + offset)


def constant(name: str, value: float) -> Plant:
    return only(name, lambda x: np.full_like(x, value))


def quantised(name: str, step: float) -> Plant:
    return only(name, lambda x: np.round(x / step) * step)


def held(name: str, size: int) -> Plant:
    return only(name, lambda x: x[np.arange(len(x)) // size * size])


def clipped(name: str, share: float) -> Plant:
    return only(name, lambda x: np.clip(x, *(share * np.abs(x).max() * np.array([-1.0, 1.0]))))


def wrapped(name: str) -> Plant:
    return only(name, lambda x: (x - np.median(x)) % (2 * np.pi) + np.median(x))


def every(names: tuple[str, ...], factor: float) -> Plant:
    return those(names.__contains__, lambda x: x * factor)


def negated(*names: str) -> Plant:
    return every(names, -1.0)


def all_scaled(suffix: str, factor: float) -> Plant:
    return those(lambda name: name.endswith(suffix), lambda x: x * factor)


def beginning(prefix: str, factor: float) -> Plant:
    return those(lambda name: name.startswith(prefix), lambda x: x * factor)


def delayed(prefix: str, samples: int) -> Plant:
    return those(lambda name: name.startswith(prefix), lambda x: np.roll(x, samples))


def beside(joint: str, motor: str, sensor: str) -> Plant:
    """A second sensor at every joint, reversed at one."""

    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for name in [name for name in columns if name.endswith(motor)]:
            sign = -1.0 if name == f"{joint}{motor}" else 1.0
            columns[name.replace(motor, sensor)] = sign * columns[name]

    return plant


def swapped(*pairs: tuple[str, str]) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        for a, b in pairs:
            columns[a], columns[b] = columns[b], columns[a]

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


def missing(name: str, share: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        inside = rng.choice(len(columns[name]) - 20, int(share * len(columns[name]))) + 10
        columns[name][inside] = np.nan

    return plant


def taken(columns: Columns, rows: NDArray[np.intp] | NDArray[np.bool_]) -> None:
    """Some rows of all columns, in an order."""
    columns.update({name: values[rows] for name, values in columns.items()})


def cut(start: float, stop: float) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        t = columns["t"] - columns["t"][0]
        taken(columns, (t < start) | (t > stop))

    return plant


def jittered(columns: Columns, rng: np.random.Generator) -> None:
    t = columns["t"]
    taken(columns, np.sort(rng.choice(len(t), int(0.6 * len(t)), replace=False)))
    # Bursts of stamps, as of a buffered reader: in order, but far from even.
    kept = columns["t"]
    steps = np.diff(kept).mean() * rng.exponential(1.0, len(kept)).clip(0.01, 4.0)
    columns["t"] = t[0] + np.cumsum(steps)


def exchanged_rows(columns: Columns, rng: np.random.Generator) -> None:
    order = np.arange(len(columns["t"]))
    for at in (300, 900, 1500):
        order[[at, at + 1]] = order[[at + 1, at]]
    taken(columns, order)


def repeated_rows(columns: Columns, rng: np.random.Generator) -> None:
    taken(columns, np.sort(np.concatenate([np.arange(len(columns["t"])), [200, 700, 701, 702]])))


def called(columns: Columns, name_of: Callable[[str], str]) -> None:
    """Give the columns other names, the columns without a name up."""
    named = {name_of(name): values for name, values in columns.items()}
    columns.clear()
    columns.update({name: values for name, values in named.items() if name})


def renamed(old: str, new: str) -> Plant:
    return lambda columns, _: called(
        columns, lambda name: new + name[len(old) :] if name.startswith(old) else name
    )


def ending(old: str, new: str) -> Plant:
    return lambda columns, _: called(
        columns, lambda name: name.removesuffix(old) + new if name.endswith(old) else name
    )


def without(suffix: str) -> Plant:
    return lambda columns, _: called(columns, lambda name: "" if name.endswith(suffix) else name)


def commanded_gravity(columns: Columns, rng: np.random.Generator) -> None:
    q = columns["elbow.position"]
    columns["elbow.current"] = 0.4 * np.cos(q) + 0.1


def both(first: Plant, second: Plant) -> Plant:
    def plant(columns: Columns, rng: np.random.Generator) -> None:
        first(columns, rng)
        second(columns, rng)

    return plant
