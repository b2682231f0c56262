"""Logged velocities against the positions, over windows in which the encoder sees motion."""

from collections.abc import Container, Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.shares import percent
from seqid_cli.typing import Mask

COUNTS = 10.0  # encoder steps of travel that make a window count
FEWEST = 10
NEAR = 0.15
CORRELATED = 0.9


def velocity_findings(
    data: LogData,
    broken: Container[str] = (),
    *,
    windows_s: tuple[float, ...] = (0.1, 0.2, 0.5, 1.0),
) -> Iterator[InspectionFinding]:
    """Check the velocity of every joint that moves, but for the joints named in `broken`."""
    if data.recording.dq is None:
        return
    names = data.robot.joint_names
    sound = [j for j in range(data.robot.n) if names[j] not in broken]
    choices = [_windows(data, seconds) for seconds in windows_s]
    judged = [[j for j in sound if one.counts[:, j].sum() >= FEWEST] for one in choices]
    # The shortest windows that show as many joints as any; max takes the first of equals.
    best = max(range(len(choices)), key=lambda k: len(judged[k]))
    (_, travel, integral, counts), moving = choices[best], judged[best]
    crossed = _crossed(travel, integral, moving)
    paired = {j for pair in crossed for j in pair}
    alone = [j for j in sound if j not in paired]
    dead = {j: seconds for j in alone if (seconds := _dead_s(data, choices, j))}
    for j, seconds in dead.items():
        text = f"stands still for {seconds:.2g} s in which its velocity moves it"
        yield found("position_stuck", text, joint=names[j], channel="position")
    live = [j for j in moving if j not in dead]
    fits = {j: _fit(travel[counts[:, j], j], integral[counts[:, j], j]) for j in live}
    gains = [gain for gain, r, _ in fits.values() if abs(r) > CORRELATED]
    for factor in (1e-3, 1e-6, 1e3, 1e6) if gains else ():  # by which all gains are off
        if all(abs(gain / factor - 1.0) < NEAR for gain in gains):
            text = (
                f"the velocity is {1 / factor:.3g} times the slope of the position at every joint"
            )
            yield found("time_unit", text, channel="t")
            return
    for a, b in crossed:
        text = f"the velocity of {names[a]} fits the position of {names[b]} and the other way round"
        yield found("joints_swapped", text, joint=f"{names[a]}, {names[b]}", channel="velocity")
    for j in live:
        if j not in paired:
            yield from _verdict(data, j, *fits[j])


class _Windows(NamedTuple):
    """Windows of some length: travel of the positions, integral of the velocities (W, n)."""

    seconds: float
    travel: Array
    integral: Array
    counts: Mask  # (W, n) where the encoders see enough to be judged


def _windows(data: LogData, seconds: float) -> _Windows:
    recording = data.recording
    assert recording.dq is not None
    width = max(2, round(seconds * recording.rate_hz))
    edges = np.arange(0, len(recording.t), width)
    step = 1.0 / recording.rate_hz
    middles = 0.5 * (recording.dq[1:] + recording.dq[:-1]) * step
    total = np.vstack([np.zeros((1, data.robot.n)), np.cumsum(middles, axis=0)])
    broken = np.concatenate([[0], np.cumsum(~recording.valid)])[edges]
    whole = np.diff(broken) == 0
    travel = np.diff(recording.q[edges], axis=0)[whole]
    counts = np.abs(travel) > COUNTS * data.step
    return _Windows(seconds, travel, np.diff(total[edges], axis=0)[whole], counts)


def _dead_s(
    data: LogData,
    choices: list[_Windows],
    j: int,
    *,
    min_share: float = 0.3,  # of a window's usual travel
) -> float:
    """Seconds in which a joint's velocity moves it and its position does not; 0 if too few."""
    for windows in choices:
        size = np.abs(windows.integral[:, j])
        if not len(size):
            continue
        fast = max(COUNTS * float(data.step[j]), min_share * float(np.quantile(size, 0.9)))
        dead = (windows.travel[:, j] == 0.0) & (size > fast)
        if dead.sum() >= FEWEST:
            return windows.seconds * float(dead.sum())
    return 0.0


def _fit(travel: Array, integral: Array) -> tuple[float, float, float]:
    """Gain from integral to travel, their correlation, and the ratio of their RMS."""
    energy, power = float(integral @ integral), float(travel @ travel)
    ratio = float(np.sqrt(energy / max(power, 1e-300)))
    if energy <= 0.0 or power <= 0.0:
        return 0.0, 0.0, ratio
    product = float(travel @ integral)
    return product / energy, product / np.sqrt(energy * power), ratio


def _crossed(
    travel: Array, integral: Array, judged: list[int], *, min_crossed: float = 0.95
) -> list[tuple[int, int]]:
    """Pairs of joints whose velocities fit each other's positions and not their own."""
    sizes = [np.sqrt(np.sum(x**2, axis=0, keepdims=True)) for x in (travel, integral)]
    fits = (travel / np.maximum(sizes[0], 1e-300)).T @ (integral / np.maximum(sizes[1], 1e-300))
    return [
        (a, b)
        for a, b in combinations(judged, 2)
        if min(fits[a, b], fits[b, a]) > min_crossed and max(fits[a, a], fits[b, b]) < CORRELATED
    ]


def _verdict(
    data: LogData,
    j: int,
    gain: float,
    correlation: float,
    ratio: float,
    *,
    max_empty: float = 0.05,
    min_gain: float = 0.8,
    max_gain: float = 1.25,
) -> Iterator[InspectionFinding]:
    joint = data.robot.joints[j]
    if ratio < max_empty and abs(correlation) < CORRELATED:
        text = f"integrates to {percent(ratio)} of the position's travel"
        yield found("velocity_zero", text, joint=joint.name, channel="velocity")
        return
    degrees = np.degrees(1.0)
    codes = {"position_in_degrees": degrees, "velocity_in_degrees": 1.0 / degrees}
    if joint.prismatic:
        codes = {"position_in_mm": 1000.0}
    text = f"the position changes by {gain:.3g} times the velocity's integral"
    for code, factor in {**codes, "velocity_sign": -1.0}.items():
        near = NEAR if factor > 0.0 else 0.2
        if abs(correlation) > CORRELATED and abs(gain / factor - 1.0) < near:
            yield found(code, text, joint=joint.name, channel=code.partition("_")[0])
            return
    if not min_gain < gain < max_gain or correlation < CORRELATED:
        text += f", correlation {correlation:.2f}"
        yield found("velocity_inconsistent", text, joint=joint.name, channel="velocity")
