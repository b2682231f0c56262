"""Positions: units, limits, jumps, freezes, encoder resolution."""

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from seqid_cli.inspect.channels.values import equal_runs, held, lattice, missing
from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.motion.segmentation import windowed_velocity
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Robot
from seqid_cli.typing import Index

ALONE = 0.3  # of a jump, that the samples before and after may move


@dataclass(frozen=True)
class Break:
    """Where a joint's positions are broken; `rows` are wrong, none where it is not known which."""

    joint: int
    finding: InspectionFinding
    rows: Index


def breaks_of(robot: Robot, t: Array, position: Array) -> list[Break]:
    """Find breaks of every joint's positions (M, n) rad (m) as logged at `t` (M,) s."""
    breaks = []
    for j, joint in enumerate(robot.joints):
        rows = np.flatnonzero(np.isfinite(position[:, j]))
        own_t, q = t[rows], position[rows, j]
        if len(q) < 3:
            continue
        least = ALONE * _beyond_any_arm(float(np.median(np.diff(own_t))))
        # no two changes differ by as much as a break makes
        if np.abs(np.diff(q, 2)).max() < least:
            continue
        if broken := _break(own_t, q, lattice(q)):
            code, text, wrong = broken
            breaks.append(
                Break(j, found(code, text, joint.name, "position"), rows[wrong])
            )
    return breaks


def position_findings(
    data: LogData, breaks: Sequence[Break]
) -> Iterator[InspectionFinding]:
    """Check every joint's positions; `breaks` are those of `breaks_of`."""
    for j in range(data.robot.n):
        broken = [each.finding for each in breaks if each.joint == j]
        yield from broken or filter(None, [_unit(data, j)])


def position_quality(
    data: LogData, broken: Container[str], *, max_ratio: float = 2.0
) -> Iterator[InspectionFinding]:
    """Check how well positions are measured, but for the joints named in `broken`."""
    for j, joint in enumerate(data.robot.joints):
        column = data.joints.channels["position"][:, j]
        q = column[np.isfinite(column)]
        if len(q) < 3:
            continue
        yield from missing(column, joint.name, "position")
        if joint.name in broken:
            continue
        size, step = held(q), lattice(q)
        declared = joint.encoder_resolution or step
        if (
            step
            and np.ptp(q) > 20 * max(declared, step)
            and abs(step / declared - 1.0) > 0.1
        ):
            text = f"its step is {step:.4g}, the robot file says {declared:.4g}"
            yield found("encoder_resolution", text, joint.name, "position")
        if size > 1 and data.moves(j):
            text = f"the position repeats each value {size} times"
            yield found("channel_held", text, joint.name, "position")
        top, limit = top_speed(data, j), joint.velocity_limit
        if limit is not None and top > max_ratio * limit:
            text = f"reaches {top:.3g}, velocity_limit is {limit:.3g}"
            yield found("speed_limit", text, joint.name, "position")


def _unit(
    data: LogData, j: int, *, min_outside: float = 0.02
) -> InspectionFinding | None:
    """Compare with the limits, as they are and in other units; `min_outside` of their span."""
    joint = data.robot.joints[j]
    column = data.joints.channels["position"][:, j]
    q = column[np.isfinite(column)]
    if joint.position_limits is None or len(q) < 3:
        return None
    low, high = joint.position_limits
    span, unit = high - low, "m" if joint.prismatic else "rad"
    margin = max(3.0 * data.step[j], min_outside * span)
    least, most = float(q.min()), float(q.max())

    def within(factor: float) -> bool:
        ends = sorted((least / factor, most / factor))
        return bool(ends[0] >= low - margin and ends[1] <= high + margin)

    if within(1.0):
        return None
    text = (
        f"runs from {least:.4g} to {most:.4g}, the limits are {low:.4g} to {high:.4g}"
        f" {unit}"
    )
    degrees, mm = ("position_in_degrees", np.degrees(1.0)), ("position_in_mm", 1000.0)
    choices = [mm if joint.prismatic else degrees]
    if joint.gear_ratio is not None and abs(joint.gear_ratio) > 3.0:
        choices.append(("position_motor_side", joint.gear_ratio))
    # how many times its declared step is the position's step?
    if joint.encoder_resolution:
        ratio = max(lattice(q), 1e-12) / joint.encoder_resolution
        choices.sort(key=lambda choice: abs(np.log(ratio / abs(choice[1]))))
    beyond = max(low - least, most - high)
    for code, factor in choices:
        fills = (most - least) / abs(factor) >= min_outside * span
        if beyond > span and fills and within(factor):
            return found(code, text, joint.name, "position")
    return found("position_limits", text, joint.name, "position")


def fast_in_degrees(
    data: LogData, *, max_speed: float = 20.0
) -> Iterator[InspectionFinding]:
    """Take most joints impossibly fast for degrees; limits and velocities say it better."""
    robot = data.robot
    if data.recording.dq is not None or any(j.position_limits for j in robot.joints):
        return
    moving = [
        j for j in range(robot.n) if data.moves(j) and not robot.joints[j].prismatic
    ]
    speeds = [top_speed(data, j) for j in moving]
    if len(moving) >= 2 and float(np.median(speeds)) > max_speed:
        for j, speed in zip(moving, speeds, strict=True):
            text = f"moves at {speed:.3g} per second: it looks like degrees"
            yield found("position_in_degrees", text, robot.joints[j].name, "position")


def top_speed(data: LogData, j: int) -> float:
    """Return the top speed of a joint over 0.1 s, rad/s (m/s)."""
    half = max(1, round(0.05 * data.recording.rate_hz))
    if 2 * half + 1 >= len(data.recording.q):
        return 0.0
    velocity = windowed_velocity(data.recording.q[:, j], data.recording.rate_hz, half)
    return float(np.abs(velocity).max())


def _break(t: Array, q: Array, step: float) -> tuple[str, str, Index] | None:
    """Find freezes, else spikes, else jumps, with the samples that are wrong."""
    usual = float(np.median(np.diff(t)))
    if usual <= 0.0:
        return None
    large = _least_jump(q, step, usual)
    if frozen := _frozen(t, q, large):
        start, stop = frozen[0]
        text = f"stands still {len(frozen)} times, first from {t[start]:.3f} s for "
        text += (
            f"{t[stop - 1] - t[start]:.3f} s, and then catches up by"
            f" {q[stop] - q[stop - 1]:.3g}"
        )
        return (
            "position_frozen",
            text,
            np.concatenate([np.arange(a + 1, b) for a, b in frozen]),
        )
    d = np.diff(q)
    size = np.abs(d)
    # A jump stands alone: the motion around it is small against it (a spike returns at
    # once, and of the two changes on one side the smaller counts).
    wide = np.pad(size, 2)
    around = np.maximum(
        np.minimum(wide[:-4], wide[1:-3]), np.minimum(wide[3:-1], wide[4:])
    )
    at = np.flatnonzero(
        (size > large) & (around < ALONE * size) & (np.diff(t) < 1.5 * usual)
    )
    if not len(at):
        return None
    back: dict[int, int] = {}  # after how many samples a change is undone
    for k in at.tolist():
        undone = (
            s
            for s in (1, 2, 3)
            if k + s < len(d) and abs(d[k] + d[k + s]) < ALONE * size[k]
        )
        if s := next(undone, 0):
            back[k] = s
    first, count = next(iter(back), int(at[0])), len(back) or len(at)
    text = f"jumps by {d[first]:.4g} at {t[first + 1]:.3f} s"
    text += f" and {count - 1} more times" if count > 1 else ""
    wrong = [row for k, s in back.items() for row in range(k + 1, k + s + 1)]
    return (
        "position_spikes" if back else "position_jump",
        text,
        np.array(wrong, dtype=np.intp),
    )


def _least_jump(
    q: Array,
    step: float,
    usual: float,
    *,
    min_steps: float = 8.0,
    # times what one in a hundred changes differs from its neighbours
    min_noise: float = 6.0,
    max_jumps: int = 16,
    min_share: float = 0.005,  # of the position's range
) -> float:
    """Return the change between two samples that neither motion nor the log's own noise makes."""
    d = np.diff(q)
    uneven = np.sort(np.abs(d - median_filter(d, 5, mode="wrap")))
    noise = float(np.quantile(uneven[: max(len(d) - max_jumps, 1)], 0.99))
    span = float(np.ptp(np.quantile(q, (0.01, 0.99))))
    return max(
        min_steps * step, _beyond_any_arm(usual), min_noise * noise, min_share * span
    )


def _beyond_any_arm(
    usual: float, *, max_acceleration: float = 1000.0, max_step: float = 0.05
) -> float:
    """Return the change of velocity, times the usual time, that no arm makes."""
    # the first says little at low rates
    return min(max_acceleration * usual**2, max_step)


def _frozen(
    t: Array, q: Array, large: float, *, min_samples: int = 5, min_s: float = 0.01
) -> list[tuple[int, int]]:
    """List freezes [start, stop), each ended by a jump as far as the motion around it goes."""
    found_runs = []
    for a, b in equal_runs(q, min_samples):
        if b + 5 >= len(q) or a < 5 or t[b - 1] - t[a] < min_s:
            continue
        jump = float(q[b] - q[b - 1])
        before, after = float(q[a] - q[a - 5]) / 5, float(q[b + 5] - q[b]) / 5
        missed = 0.5 * (before + after) * (b - a)
        if abs(jump) > large and before * after > 0 and 0.5 < jump / missed < 2.0:
            found_runs.append((a, b))
    return found_runs
