"""Logged velocities against the positions, over windows in which the encoder sees motion."""

from collections.abc import Container, Iterator
from itertools import combinations, pairwise

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import welch

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Joint
from seqid_cli.shares import percent

COUNTS = 10.0  # encoder steps of travel that make a window count
FEWEST = 10
NEAR = 0.15
CORRELATED = 0.9


def velocity_findings(
    data: LogData, broken: Container[str] = (), *, window_s: float = 0.5
) -> Iterator[InspectionFinding]:
    """Check the velocity of every joint that moves, but for the joints named in `broken`."""
    if data.recording.dq is None:
        return
    names = data.robot.joint_names
    travel, integral = _windows(data, window_s)
    if not len(travel):
        return
    counts = np.sum(np.abs(travel) > COUNTS * data.step, axis=0)
    whole = [j for j, name in enumerate(names) if name not in broken]
    moving = [j for j in whole if counts[j] >= FEWEST]
    sizes = [np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (travel, integral)]
    # correlations of positions with velocities
    r = (travel / sizes[0]).T @ (integral / sizes[1])
    gains, ratios = np.diag(r) * sizes[0] / sizes[1], sizes[1] / sizes[0]
    crossed = _crossed(r, moving)
    paired = {j for pair in crossed for j in pair}
    still = _still(data, travel, integral, window_s)
    dead = [j for j in whole if still[j] >= FEWEST and j not in paired]
    for j in dead:
        text = (
            f"stands still for {window_s * still[j]:.2g} s in which its velocity"
            " moves it"
        )
        yield found("position_stuck", text, names[j], "position")
    live = [j for j in moving if j not in dead]
    clear = [gains[j] for j in live if abs(r[j, j]) > CORRELATED]
    for factor in (1e-3, 1e-6, 1e3, 1e6) if clear else ():  # by which all gains are off
        if all(abs(gain / factor - 1.0) < NEAR for gain in clear):
            text = f"velocities are {1 / factor:.3g} times the slopes of all positions"
            yield found("time_unit", text, channel="t")
            return
    for a, b in crossed:
        text = (
            f"the velocity of {names[a]} fits the position of {names[b]} and the other"
            " way round"
        )
        yield found("joints_swapped", text, f"{names[a]}, {names[b]}", "velocity")
    for j in live:
        if j not in paired:
            joint = data.robot.joints[j]
            yield from _verdict(
                joint, float(gains[j]), float(r[j, j]), float(ratios[j])
            )


def _still(
    data: LogData,
    travel: Array,
    integral: Array,
    window_s: float,
    *,
    min_share: float = 0.3,
    min_noises: float = 5.0,
) -> Array:
    """Count the windows (n,) in which the velocity moves a joint and its position stands still.

    Noise of the velocity adds up as well: over a window of T seconds white noise of
    density S makes sqrt(S T / 2). An integral below `min_noises` times that moves
    nothing.
    """
    size = np.abs(integral)
    noise = np.sqrt(0.5 * window_s * _noise_density(data))
    least = np.maximum(COUNTS * data.step, min_noises * noise)
    fast = np.maximum(least, min_share * np.quantile(size, 0.9, axis=0))
    return np.asarray(np.sum((travel == 0.0) & (size > fast), axis=0))


def _noise_density(
    data: LogData, *, motion_hz: float = 3.0, segment_s: float = 2.0
) -> Array:
    """Return the density (n,) of the velocities' noise, (rad/s)^2/Hz, one-sided.

    Arms move below `motion_hz`, noise goes on above. A drive may low-pass its velocity,
    so the octave above with the most counts, each by its median, which a line of hum
    does not lift.
    """
    recording = data.recording
    assert recording.dq is not None
    length = min(len(recording.dq), round(segment_s * recording.rate_hz))
    f, density = welch(recording.dq, recording.rate_hz, nperseg=length, axis=0)

    edges = motion_hz * 2.0 ** np.arange(12)
    inside = [(f >= low) & (f < high) for low, high in pairwise(edges)]
    octaves = [np.median(density[rows], axis=0) for rows in inside if rows.any()]
    return np.max(octaves, axis=0) if octaves else np.zeros(data.robot.n)


def _crossed(
    r: Array, moving: list[int], *, min_crossed: float = 0.95
) -> list[tuple[int, int]]:
    """Pairs of joints whose velocities fit each other's positions and not their own."""
    own = np.diag(r)
    fits = (np.minimum(r, r.T) > min_crossed) & (
        np.maximum.outer(own, own) < CORRELATED
    )
    return [pair for pair in combinations(moving, 2) if fits[pair]]


def _windows(data: LogData, seconds: float) -> tuple[Array, Array]:
    """Travel of the positions and integral of the velocities over whole windows (W, n)."""
    recording = data.recording
    assert recording.dq is not None
    width = max(2, round(seconds * recording.rate_hz))
    edges = np.arange(0, len(recording.t), width)
    total = cumulative_trapezoid(
        recording.dq, dx=1.0 / recording.rate_hz, axis=0, initial=0
    )
    whole = np.diff(np.concatenate([[0], np.cumsum(~recording.valid)])[edges]) == 0
    return (
        np.diff(recording.q[edges], axis=0)[whole],
        np.diff(total[edges], axis=0)[whole],
    )


def _verdict(
    joint: Joint,
    gain: float,
    correlation: float,
    ratio: float,
    *,
    max_empty: float = 0.05,
    min_gain: float = 0.8,
    max_gain: float = 1.25,
) -> Iterator[InspectionFinding]:
    if ratio < max_empty and abs(correlation) < CORRELATED:
        text = f"integrates to {percent(ratio)} of the position's travel"
        yield found("velocity_zero", text, joint.name, "velocity")
        return
    degrees = np.degrees(1.0)
    codes = {"position_in_degrees": degrees, "velocity_in_degrees": 1.0 / degrees}
    if joint.prismatic:
        codes = {"position_in_mm": 1000.0}
    text = f"the position changes by {gain:.3g} times the velocity's integral"
    for code, factor in {**codes, "velocity_sign": -1.0}.items():
        near = NEAR if factor > 0.0 else 0.2
        if abs(correlation) > CORRELATED and abs(gain / factor - 1.0) < near:
            yield found(code, text, joint.name, code.partition("_")[0])
            return
    if not min_gain < gain < max_gain or correlation < CORRELATED:
        text += f", correlation {correlation:.2f}"
        yield found("velocity_inconsistent", text, joint.name, "velocity")
