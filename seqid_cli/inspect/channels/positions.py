"""Positions of joints: units, limits, jumps, freezes, encoder resolution."""

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from msgspec import structs

from seqid_cli.inspect.channels.values import equal_runs, held, lattice
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.scales import Scale, angle_scales
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Robot
from seqid_cli.running import median_of_five
from seqid_cli.typing import Index

ALONE = 0.3  # of a jump, that the samples before and after may move


@dataclass(frozen=True)
class Break:
    """Broken positions of a joint; `rows` are those known to be wrong, or none."""

    joint: int
    finding: InspectionFinding
    rows: Index


class _Damage(NamedTuple):
    """What is wrong with positions: code, message, and the samples that are wrong."""

    code: str
    text: str
    rows: Index


def breaks_of(robot: Robot, t: Array, position: Array) -> list[Break]:
    """Find breaks in the positions of every joint.

    Parameters
    ----------
    robot : Robot
        The arm, of n joints.
    t : (M,) array
        Times of the samples [s].
    position : (M, n) array
        Positions as they were logged [rad; m], NaN where there is none.
    """
    breaks = []
    for j, joint in enumerate(robot.joints):
        rows = np.flatnonzero(np.isfinite(position[:, j]))
        if len(rows) < 3:
            continue
        t_joint = t[rows]
        q = position[rows, j]

        # Most joints end here: no two changes differ by as much as a break makes.
        interval = float(np.median(np.diff(t_joint)))
        beyond = _beyond_any_arm(interval, joint.velocity_limit)
        if np.abs(np.diff(q, 2)).max() < ALONE * beyond:
            continue
        damage = _damage(t_joint, q, lattice(q), joint.velocity_limit)
        if damage is not None:
            finding = finding_of(damage.code, damage.text, joint.name, "position")
            breaks.append(Break(joint=j, finding=finding, rows=rows[damage.rows]))
    return breaks


def position_findings(
    data: LogData, breaks: Sequence[Break]
) -> Iterator[InspectionFinding]:
    """Check every joint's positions; `breaks` are those of `breaks_of`."""
    for j in range(data.robot.n):
        of_joint = [damage.finding for damage in breaks if damage.joint == j]
        if of_joint:
            yield from of_joint
            continue
        finding = _unit(data, j)
        if finding is not None:
            yield finding


def position_quality(
    data: LogData, broken: Container[str]
) -> Iterator[InspectionFinding]:
    """Check how well positions are measured.

    Parameters
    ----------
    data : LogData
        The log.
    broken : container of str
        Joints that are left out.
    """
    settings = data.settings.channels
    for j, joint in enumerate(data.robot.joints):
        column = data.joints.channels["position"][:, j]
        q = column[np.isfinite(column)]
        if len(q) < 3:
            continue
        if joint.name in broken:
            continue

        step = lattice(q)
        declared = joint.encoder_resolution or step
        # Of a few steps their size is not certain.
        travels_far = np.ptp(q) > 20 * max(declared, step)
        if step and travels_far and abs(step / declared - 1.0) > 0.1:
            text = f"its step is {step:.4g}, the robot file says {declared:.4g}"
            yield finding_of("encoder_resolution", text, joint.name, "position")

        group_size = held(q)
        if group_size > 1 and data.moves(j):
            text = f"the position repeats each value {group_size} times"
            yield finding_of("channel_held", text, joint.name, "position")

        speed = top_speed(data, j)
        limit = joint.velocity_limit
        if limit is not None and speed > settings.max_speed * limit:
            text = f"reaches {speed:.3g}, velocity_limit is {limit:.3g}"
            yield finding_of("speed_limit", text, joint.name, "position")


def _unit(
    data: LogData, j: int, *, min_outside: float = 0.02
) -> InspectionFinding | None:
    """Compare positions with the limits, as they are and in other units.

    `min_outside` is the share of the limits' span by which they must be exceeded.
    """
    joint = data.robot.joints[j]
    column = data.joints.channels["position"][:, j]
    q = column[np.isfinite(column)]
    if joint.position_limits is None or len(q) < 3:
        return None
    low, high = joint.position_limits
    span = high - low
    margin = max(3.0 * data.step[j], min_outside * span)
    least = float(q.min())
    most = float(q.max())

    def is_within(factor: float) -> bool:
        ends = sorted((factor * least, factor * most))
        return bool(ends[0] >= low - margin and ends[1] <= high + margin)

    if is_within(1.0):
        return None

    text = (
        f"runs from {least:.4g} to {most:.4g}, the limits are {low:.4g} to {high:.4g}"
        f" {'m' if joint.prismatic else 'rad'}"
    )
    beyond = max(low - least, most - high)
    for scale in _other_units(data.robot, j, lattice(q)):
        factor = float(scale.factors[j])
        # In a unit so large that hardly any motion is left, anything is within.
        fills = (most - least) * abs(factor) >= min_outside * span
        if beyond > span and fills and is_within(factor):
            finding = finding_of(scale.code, text, joint.name, "position")
            return structs.replace(finding, remedy=scale.remedy or finding.remedy)
    return finding_of("position_limits", text, joint.name, "position")


def _other_units(robot: Robot, j: int, step: float) -> list[Scale]:
    """Return units that a joint's positions of this `step` may be in, likeliest first.

    Percent of the range is none of them: any position would be within the limits.
    """
    joint = robot.joints[j]
    if joint.prismatic:
        metres = np.full(robot.n, 1e-3)
        scales = [Scale(code="position_in_mm", factors=metres, text="is in mm")]
        scales += [s for s in angle_scales(robot) if s.code == "position_motor_side"]
    else:
        scales = [s for s in angle_scales(robot) if s.code != "position_in_percent"]
        # Whole numbers are counts.
        is_whole = step > 0.0 and abs(step - round(step)) < 1e-6
        scales.sort(key=lambda s: (s.code == "position_in_counts") != is_whole)
    has_gear = abs(joint.gear_ratio or 1.0) > 3.0
    scales = [s for s in scales if s.code != "position_motor_side" or has_gear]
    scales = [s for s in scales if np.isfinite(s.factors[j])]
    # The encoder's step is in the same unit: is it that of the robot file?
    if joint.encoder_resolution:
        ratio = joint.encoder_resolution / max(step, 1e-12)
        scales.sort(key=lambda s: abs(np.log(ratio / abs(s.factors[j]))))
    return scales


def too_fast(data: LogData, *, max_speed: float = 20.0) -> Iterator[InspectionFinding]:
    """Take positions for those in another unit where most joints are too fast.

    `max_speed` [rad/s] is beyond any arm; the first unit in which they are slower is
    the likeliest. Limits and velocities say it better: with either of them there is
    nothing to do here.
    """
    robot = data.robot
    if data.recording.dq is not None or any(j.position_limits for j in robot.joints):
        return
    moving = [
        j for j in range(robot.n) if data.moves(j) and not robot.joints[j].prismatic
    ]
    speeds = np.array([top_speed(data, j) for j in moving])
    if len(moving) < 2 or float(np.median(speeds)) <= max_speed:
        return

    column = data.joints.channels["position"][:, moving[0]]
    step = lattice(column[np.isfinite(column)])
    for scale in _other_units(robot, moving[0], step):
        factor = float(np.median(np.abs(scale.factors[moving])))
        if not factor * float(np.median(speeds)) < max_speed:
            continue
        for j, speed in zip(moving, speeds.tolist(), strict=True):
            words = scale.text.removeprefix("is ").removeprefix("in ")
            text = f"moves at {speed:.3g} per second: it looks like {words}"
            name = robot.joints[j].name
            finding = finding_of(scale.code, text, name, "position")
            yield structs.replace(finding, remedy=scale.remedy or finding.remedy)
        return


def top_speed(data: LogData, j: int) -> float:
    """Return the top speed of a joint over 0.1 s, rad/s (m/s)."""
    return data.top_speed(j)


def _damage(
    t: Array, q: Array, step: float, velocity_limit: float | None
) -> _Damage | None:
    """Find freezes, else spikes, else jumps, in positions (M,) at times (M,).

    `step` is the encoder's, `velocity_limit` [rad/s] the joint's, if it is known.
    """
    interval = float(np.median(np.diff(t)))
    if interval <= 0.0:
        return None
    least_jump = _least_jump(q, step, interval, velocity_limit)
    frozen = _frozen(t, q, least_jump)
    if frozen:
        return _freezes(t, q, frozen)

    # A jump stands alone: the motion around it is small against it (a spike returns at
    # once, and of the two changes on one side the smaller counts).
    change = np.diff(q)
    size = np.abs(change)
    padded = np.pad(size, 2)
    earlier = np.minimum(padded[:-4], padded[1:-3])
    later = np.minimum(padded[3:-1], padded[4:])
    stands_alone = np.maximum(earlier, later) < ALONE * size
    in_time = np.diff(t) < 1.5 * interval
    jumps = np.flatnonzero((size > least_jump) & stands_alone & in_time)
    if not len(jumps):
        return None

    # Of spikes it is known which samples are wrong, of jumps it is not.
    undone_after = {k: _undone_after(change, k) for k in jumps.tolist()}
    spikes = {k: count for k, count in undone_after.items() if count}
    if spikes:
        code = "position_spikes"
        first = next(iter(spikes))
        n_jumps = len(spikes)
    else:
        code = "position_jump"
        first = int(jumps[0])
        n_jumps = len(jumps)
    text = f"jumps by {change[first]:.4g} at {t[first + 1]:.3f} s"
    if n_jumps > 1:
        text += f" and {n_jumps - 1} more times"
    wrong = [row for k, count in spikes.items() for row in range(k + 1, k + count + 1)]
    return _Damage(code, text, np.array(wrong, dtype=np.intp))


def _undone_after(change: Array, k: int) -> int:
    """Return after how many samples, up to three, a change is undone; 0: it is not."""
    for count in (1, 2, 3):
        if k + count >= len(change):
            return 0
        if abs(change[k] + change[k + count]) < ALONE * abs(change[k]):
            return count
    return 0


def _least_jump(
    q: Array,
    step: float,
    interval: float,
    velocity_limit: float | None,
    *,
    min_steps: float = 8.0,
    # times what one in a hundred changes differs from its neighbours
    min_noise: float = 6.0,
    max_jumps: int = 16,
    min_share: float = 0.005,  # of the position's range
) -> float:
    """Return the change between two samples that neither motion nor noise makes.

    `interval` is the usual time between samples [s], `velocity_limit` [rad/s] that of
    the joint, if it is known.
    """
    change = np.diff(q)
    uneven = np.sort(np.abs(change - median_of_five(change, beyond="wrap")))
    # The jumps themselves must not count as noise.
    without_jumps = uneven[: max(len(change) - max_jumps, 1)]
    noise = float(np.quantile(without_jumps, 0.99))
    span = float(np.ptp(np.quantile(q, (0.01, 0.99))))
    return max(
        min_steps * step,
        _beyond_any_arm(interval, velocity_limit),
        min_noise * noise,
        min_share * span,
    )


def _beyond_any_arm(
    interval: float,
    velocity_limit: float | None,
    *,
    max_acceleration: float = 1000.0,
    fastest: float = 10.0,
    overshoot: float = 1.5,
) -> float:
    """Return the change of velocity, times the usual interval, that no arm makes.

    At low rates the acceleration says little: between two samples an arm may start from
    rest and move at the speed of its limit, with some `overshoot`, or of the `fastest`
    arms [rad/s].
    """
    speed = fastest
    if velocity_limit is not None:
        speed = min(overshoot * velocity_limit, fastest)
    return min(max_acceleration * interval**2, speed * interval)


def _frozen(
    t: Array, q: Array, least_jump: float, *, min_samples: int = 5, min_s: float = 0.01
) -> list[tuple[int, int]]:
    """Return freezes [start, stop), each ended by a jump as far as the motion goes."""
    freezes = []
    for start, stop in equal_runs(q, min_samples):
        if stop + 5 >= len(q) or start < 5 or t[stop - 1] - t[start] < min_s:
            continue
        jump = float(q[stop] - q[stop - 1])
        slope_before = float(q[start] - q[start - 5]) / 5
        slope_after = float(q[stop + 5] - q[stop]) / 5
        missed = 0.5 * (slope_before + slope_after) * (stop - start)
        goes_on = slope_before * slope_after > 0
        if abs(jump) > least_jump and goes_on and 0.5 < jump / missed < 2.0:
            freezes.append((start, stop))
    return freezes


def _freezes(t: Array, q: Array, frozen: Sequence[tuple[int, int]]) -> _Damage:
    """Describe freezes [start, stop): all samples but the first of each are wrong."""
    start, stop = frozen[0]
    text = (
        f"stands still {len(frozen)} times, first from {t[start]:.3f} s for"
        f" {t[stop - 1] - t[start]:.3f} s, and then catches up by"
        f" {q[stop] - q[stop - 1]:.3g}"
    )
    rows = np.concatenate([np.arange(start + 1, stop) for start, stop in frozen])
    return _Damage("position_frozen", text, rows)
