"""Logged velocities against the positions, over windows in which the encoder sees motion."""

from collections.abc import Container, Iterator
from itertools import combinations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.shares import percent

COUNTS = 10.0  # encoder steps of travel that make a window count
FEWEST = 10
NEAR = 0.15
CORRELATED = 0.9


def velocity_findings(
    data: LogData,
    broken: Container[str] = (),
    *,
    window_s: float = 0.5,
    min_share: float = 0.3,  # of a window's usual travel
) -> Iterator[InspectionFinding]:
    """Check the velocity of every joint that moves, but for the joints named in `broken`."""
    if data.recording.dq is None:
        return
    names = data.robot.joint_names
    travel, integral = _windows(data, window_s)
    if not len(travel):
        return
    counts = np.abs(travel) > COUNTS * data.step
    moving = [
        j for j, name in enumerate(names) if name not in broken and counts[:, j].sum() >= FEWEST
    ]
    crossed = _crossed(travel, integral, moving)
    paired = {j for pair in crossed for j in pair}
    fast = np.maximum(COUNTS * data.step, min_share * np.quantile(np.abs(integral), 0.9, axis=0))
    still = np.count_nonzero((travel == 0.0) & (np.abs(integral) > fast), axis=0)
    dead = [
        j
        for j, name in enumerate(names)
        if still[j] >= FEWEST and j not in paired and name not in broken
    ]
    for j in dead:
        text = f"stands still for {window_s * still[j]:.2g} s in which its velocity moves it"
        yield found("position_stuck", text, joint=names[j], channel="position")
    live = [j for j in moving if j not in dead]
    fits = {j: _fit(travel[counts[:, j], j], integral[counts[:, j], j]) for j in live}
    gains = [gain for gain, r, _ in fits.values() if abs(r) > CORRELATED]
    for factor in (1e-3, 1e-6, 1e3, 1e6) if gains else ():  # by which all gains are off
        if all(abs(gain / factor - 1.0) < NEAR for gain in gains):
            text = f"velocities are {1 / factor:.3g} times the slopes of all positions"
            yield found("time_unit", text, channel="t")
            return
    for a, b in crossed:
        text = f"the velocity of {names[a]} fits the position of {names[b]} and the other way round"
        yield found("joints_swapped", text, joint=f"{names[a]}, {names[b]}", channel="velocity")
    for j in live:
        if j not in paired:
            yield from _verdict(data, j, *fits[j])


def _windows(data: LogData, seconds: float) -> tuple[Array, Array]:
    """Travel of the positions and integral of the velocities over whole windows (W, n)."""
    recording = data.recording
    assert recording.dq is not None
    width = max(2, round(seconds * recording.rate_hz))
    edges = np.arange(0, len(recording.t), width)
    total = cumulative_trapezoid(recording.dq, dx=1.0 / recording.rate_hz, axis=0, initial=0)
    broken = np.concatenate([[0], np.cumsum(~recording.valid)])[edges]
    whole = np.diff(broken) == 0
    return np.diff(recording.q[edges], axis=0)[whole], np.diff(total[edges], axis=0)[whole]


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
