"""Logged velocities against positions, over windows in which the encoder sees motion.

In a window a joint travels x, and its velocity integrates to y. Of all windows W with
travels X (W, n) and integrals Y (W, n), r = X' Y / (|X| |Y|) are correlations, and the
gain of joint j, by which its position moves per integral of its velocity, is the
coefficient r_jj |X_j| / |Y_j| of a regression.
"""

from collections.abc import Container, Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from msgspec import structs

from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.scales import (
    Factor,
    Scale,
    first_agreeing,
    slope_scales,
    time_scales,
)
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Robot
from seqid_cli.shares import percent
from seqid_cli.spectra import welch

COUNTS = 10.0  # encoder steps of travel that make a window count
FEWEST = 10  # windows in which a joint moves
NEAR = 0.15  # of a factor, by which a gain may differ from it
CORRELATED = 0.9


@dataclass(frozen=True)
class _Windows:
    """Travels of the positions and integrals of the velocities over windows (W, n)."""

    travel: Array
    integral: Array

    def __len__(self) -> int:
        return len(self.travel)


def velocity_findings(
    data: LogData, broken: Container[str] = (), *, window_s: float = 0.5
) -> Iterator[InspectionFinding]:
    """Check the velocity of every joint that moves.

    Parameters
    ----------
    data : LogData
        The log.
    broken : container of str
        Joints whose positions are known to be wrong, which are left out.
    window_s : float
        Length of a window [s].
    """
    if data.recording.dq is None:
        return
    names = data.robot.joint_names
    windows = _windows(data, window_s)
    if not len(windows):
        return
    n_windows = np.sum(np.abs(windows.travel) > COUNTS * data.step, axis=0)
    sound = [j for j, name in enumerate(names) if name not in broken]
    moving = [j for j in sound if n_windows[j] >= FEWEST]

    travel_size = np.maximum(np.linalg.norm(windows.travel, axis=0), 1e-300)
    integral_size = np.maximum(np.linalg.norm(windows.integral, axis=0), 1e-300)
    r = (windows.travel / travel_size).T @ (windows.integral / integral_size)
    gains = np.diag(r) * travel_size / integral_size
    ratios = integral_size / travel_size

    # A position that stands still says nothing of the velocity.
    crossed = _crossed(r, moving)
    crossed_joints = {j for pair in crossed for j in pair}
    n_still = _still(data, windows, window_s)
    stuck = [j for j in sound if n_still[j] >= FEWEST and j not in crossed_joints]
    for j in stuck:
        seconds = window_s * n_still[j]
        text = f"stands still for {seconds:.2g} s in which its velocity moves it"
        yield finding_of("position_stuck", text, names[j], "position")
    live = [j for j in moving if j not in stuck]

    factors = {j: _factor(gains[j], r[j, j], int(n_windows[j])) for j in live}
    clear = {j: factor for j, factor in factors.items() if abs(r[j, j]) > CORRELATED}
    of_time = _of_time(data.robot, clear)
    if of_time is not None:
        yield of_time
        return

    for a, b in crossed:
        text = (
            f"the velocity of {names[a]} fits the position of {names[b]} and the other"
            " way round"
        )
        yield finding_of("joints_swapped", text, f"{names[a]}, {names[b]}", "velocity")
    for j in live:
        if j not in crossed_joints:
            yield from _verdict(
                data.robot, j, factors[j], float(r[j, j]), float(ratios[j])
            )


def _factor(gain: float, correlation: float, n_windows: int) -> Factor:
    """Return a gain as the factor of slopes, with its error over so many windows."""
    left = max(1.0 / max(correlation**2, 1e-12) - 1.0, 0.0)
    std_error = abs(gain) * float(np.sqrt(left / max(n_windows - 2, 1)))
    return Factor(value=float(gain), std_error=std_error)


def _of_time(
    robot: Robot, factors: dict[int, Factor], *, min_speed: float = 1.25
) -> InspectionFinding | None:
    """Find another unit of time, or a log that was played at another speed.

    Either gives the slopes of all joints one factor; so do velocities of all joints in
    another unit, which is likelier where one is known.

    Parameters
    ----------
    robot : Robot
        The arm.
    factors : dict of int to Factor
        Slopes over velocities, of joints where both go together.
    min_speed : float
        Factor, or its inverse, from which on a speed of playing is said.
    """
    measured = [*factors.items()]
    if not measured:
        return None
    usual = float(np.median([factor.value for factor in factors.values()]))
    unit = first_agreeing(measured, time_scales(robot), NEAR)
    if unit is not None:
        text = (
            f"velocities are {1.0 / usual:.3g} times the slopes of all positions:"
            f" {unit.text}"
        )
        finding = finding_of(unit.code, text, channel="t")
        return structs.replace(finding, remedy=unit.remedy)

    is_known = first_agreeing(measured, slope_scales(robot), NEAR) is not None
    is_common = all(factor.agrees(usual) for factor in factors.values())
    is_other = usual > 0.0 and abs(np.log(usual)) > np.log(min_speed)
    if len(measured) < 2 or is_known or not (is_common and is_other):
        return None
    precision = float(np.median([f.std_error for f in factors.values()]))
    text = (
        f"all positions change by {usual:.4g} +- {precision:.1g} times the integrals of"
        f" their velocities: was the log played at {usual:.3g} times its speed, and"
        " recorded again by the times of arrival?"
    )
    return finding_of("time_scale", text, channel="t")


def _still(
    data: LogData,
    windows: _Windows,
    window_s: float,
    *,
    min_share: float = 0.3,
    min_noises: float = 5.0,
) -> Array:
    """Count the windows (n,) in which a velocity moves a joint whose position stands.

    Noise of the velocity adds up as well: over a window of T seconds white noise of
    density S makes sqrt(S T / 2). An integral below `min_noises` times that moves
    nothing.
    """
    size = np.abs(windows.integral)
    noise = np.sqrt(0.5 * window_s * _noise_density(data))
    least = np.maximum(COUNTS * data.step, min_noises * noise)
    fast = np.maximum(least, min_share * np.quantile(size, 0.9, axis=0))
    is_still = (windows.travel == 0.0) & (size > fast)
    return np.asarray(np.sum(is_still, axis=0))


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
    f, density = welch(recording.dq, recording.rate_hz, length)

    edges = motion_hz * 2.0 ** np.arange(12)
    octaves = []
    for low, high in pairwise(edges):
        inside = (f >= low) & (f < high)
        if inside.any():
            octaves.append(np.median(density[inside], axis=0))
    return np.max(octaves, axis=0) if octaves else np.zeros(data.robot.n)


def _crossed(
    r: Array, moving: list[int], *, min_crossed: float = 0.95
) -> list[tuple[int, int]]:
    """Return pairs of joints whose velocities fit each other's positions only."""
    own = np.diag(r)
    fit_each_other = np.minimum(r, r.T) > min_crossed
    fit_themselves = np.maximum.outer(own, own) >= CORRELATED
    return [
        pair
        for pair in combinations(moving, 2)
        if fit_each_other[pair] and not fit_themselves[pair]
    ]


def _windows(data: LogData, seconds: float) -> _Windows:
    """Integrate the velocities over windows without a gap."""
    recording = data.recording
    assert recording.dq is not None
    width = max(2, round(seconds * recording.rate_hz))
    edges = np.arange(0, len(recording.t), width)
    dq = recording.dq
    steps = 0.5 * (dq[1:] + dq[:-1]) / recording.rate_hz
    integral = np.concatenate([np.zeros_like(dq[:1]), np.cumsum(steps, axis=0)])
    n_bridged = np.concatenate([[0], np.cumsum(~recording.valid)])
    without_gap = np.diff(n_bridged[edges]) == 0
    return _Windows(
        travel=np.diff(recording.q[edges], axis=0)[without_gap],
        integral=np.diff(integral[edges], axis=0)[without_gap],
    )


def _verdict(
    robot: Robot,
    j: int,
    gain: Factor,
    correlation: float,
    ratio: float,
    *,
    max_empty: float = 0.05,
    min_gain: float = 0.8,
    max_gain: float = 1.25,
) -> Iterator[InspectionFinding]:
    """Judge the velocity of one joint.

    Parameters
    ----------
    robot : Robot
        The arm.
    j : int
        The joint.
    gain : Factor
        Travel of the position per integral of the velocity.
    correlation : float
        Correlation of the two over windows.
    ratio : float
        Size of the integral over that of the travel.
    max_empty : float
        Ratio below which a velocity is no measurement.
    min_gain, max_gain : float
        Gains between which it is right.
    """
    joint = robot.joints[j]
    if ratio < max_empty and abs(correlation) < CORRELATED:
        text = f"integrates to {percent(ratio)} of the position's travel"
        yield finding_of("velocity_zero", text, joint.name, "velocity")
        return

    text = f"the position changes by {gain.value:.3g} times the velocity's integral"
    goes_together = abs(correlation) > CORRELATED
    is_right = min_gain < gain.value < max_gain
    if goes_together and abs(gain.value + 1.0) < 0.2:
        yield finding_of("velocity_sign", text, joint.name, "velocity")
        return
    if goes_together and not is_right:
        scales = slope_scales(robot)
        if joint.prismatic:
            millimetres = np.full(robot.n, 1000.0)
            scales = [
                Scale(code="position_in_mm", factors=millimetres, text="is in mm")
            ]
        scale = first_agreeing([(j, gain)], scales, NEAR)
        if scale is not None:
            channel = scale.code.partition("_")[0]
            finding = finding_of(scale.code, text, joint.name, channel)
            if scale.code == "velocity_inconsistent":
                finding = structs.replace(finding, message=f"{text}: {scale.text}")
            remedy = scale.remedy or finding.remedy
            yield structs.replace(finding, remedy=remedy)
            return
    if not is_right or correlation < CORRELATED:
        text += f", correlation {correlation:.2f}"
        yield finding_of("velocity_inconsistent", text, joint.name, "velocity")
