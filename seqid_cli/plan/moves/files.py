"""Files of planned moves that controllers and people read.

Per move a CSV table, a ROS 2 `trajectory_msgs/JointTrajectory` as the YAML of a
FollowJointTrajectory goal, and for six revolute joints a URScript. Slowed down by a
factor s, times are t / s, speeds s v, accelerations s^2 a.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from seqid_cli.motion.planned import RATE_HZ, REST_S, rows_per_second, sampled
from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.robot.types import Array, Robot

# of JointTrajectory: controllers interpolate positions, speeds, accelerations
POINT_HZ = 25.0
SERVO_HZ = 50.0  # of URScript
DECIMALS = 6  # of s, rad, rad/s and rad/s^2 (m): a fifth of an arc second


def write_moves(
    folder: Path, moves: Sequence[PlannedMove], robot: Robot, speed_scale: float
) -> list[PlannedMove]:
    """Write the files of all moves into a folder.

    Parameters
    ----------
    folder : Path
    moves : sequence of PlannedMove
    robot : Robot
    speed_scale : float
        Factor s on the speed.

    Returns
    -------
    list of PlannedMove
        The moves with the names of their CSV files.
    """
    names = robot.joint_names
    writers = {".csv": _csv, ".yaml": _yaml}
    if robot.n == 6 and not robot.chain.prismatic.any():
        writers[".script"] = _urscript
    for move in moves:
        for suffix, text_of in writers.items():
            text = text_of(move, names, speed_scale)
            write_text_atomic(folder / f"{move.name}{suffix}", text)
    return [msgspec.structs.replace(move, file=f"{move.name}.csv") for move in moves]


@dataclass(frozen=True)
class _Rows:
    """Rows of a file: times (N,) s; positions, speeds and accelerations (N, n)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array


def _rows(
    move: PlannedMove, names: Sequence[str], speed_scale: float, rate_hz: float
) -> _Rows:
    """Return the rows of the slowed move, rounded.

    Of constant speed, and of rest, only the ends are kept: the rows between lie on a
    straight line.
    """
    t, q, dq, ddq = sampled(move, names, rate_hz)
    changed = ddq.any(axis=1) | np.diff(dq, axis=0, prepend=np.nan).any(axis=1)
    bent = np.pad(changed, 1, constant_values=True)
    on_bend = bent[:-2] | bent[1:-1] | bent[2:]
    return _Rows(
        t=_rounded((t / speed_scale)[on_bend]),
        q=_rounded(q[on_bend]),
        dq=_rounded((speed_scale * dq)[on_bend]),
        ddq=_rounded((speed_scale**2 * ddq)[on_bend]),
    )


def _rounded(values: Array) -> Array:
    """Return values of a file; adding zero makes zeros of minus zeros."""
    return np.asarray(np.round(values, DECIMALS) + 0.0)


def _csv(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    """Return a table: time, then positions, speeds and accelerations of all joints."""
    columns = ["time"]
    for quantity in ("position", "velocity", "acceleration"):
        columns += [f"{quantity}_{name}" for name in names]

    rows = _rows(move, names, speed_scale, rows_per_second(move, RATE_HZ))
    table = np.column_stack([rows.t, rows.q, rows.dq, rows.ddq])
    lines = [",".join(columns)]
    for row in table:
        lines.append(",".join(f"{x:.10g}" for x in row))
    return "\n".join(lines) + "\n"


def _yaml(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    """Return the goal of a FollowJointTrajectory action."""
    quoted = ", ".join(f'"{name}"' for name in names)
    lines = ["trajectory:", f"  joint_names: [{quoted}]", "  points:"]
    rows = _rows(move, names, speed_scale, rows_per_second(move, POINT_HZ))
    for t, q, dq, ddq in zip(rows.t, rows.q, rows.dq, rows.ddq, strict=True):
        sec, nanosec = divmod(round(t * 1e9), 1_000_000_000)
        lines += [
            f"  - positions: {_numbers(q)}",
            f"    velocities: {_numbers(dq)}",
            f"    accelerations: {_numbers(ddq)}",
            f"    time_from_start: {{sec: {sec}, nanosec: {nanosec}}}",
        ]
    return "\n".join(lines) + "\n"


def _urscript(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    """Return a program: a slow way to the start, then the move.

    Strokes are commanded as movej with their own speed, Fourier moves as servoj.
    """
    rows = _rows(move, names, speed_scale, SERVO_HZ)
    program = re.sub(r"[^A-Za-z0-9]", "_", move.name)
    lines = [
        f"def {program}():",
        f"  movej({_numbers(rows.q[0])}, a=0.3, v=0.2)",
        "  sleep(1)",
    ]
    if move.strokes:
        lines += _stroke_commands(move, rows, list(names), speed_scale)
    else:
        lines += _servo_commands(move, rows, speed_scale)
    return "\n".join([*lines, "end", f"{program}()"]) + "\n"


def _stroke_commands(
    move: PlannedMove, rows: _Rows, names: list[str], speed_scale: float
) -> list[str]:
    """Return movej to the end of each stroke, with a rest after it."""
    j = names.index(move.joints[0])
    lines = []
    for stroke in move.strokes:
        pose = rows.q[0].copy()
        pose[j] = stroke.end
        acceleration = stroke.acceleration * speed_scale**2
        speed = stroke.speed * speed_scale
        lines.append(f"  movej({_numbers(pose)}, a={acceleration:.6g}, v={speed:.6g})")
        lines.append(f"  sleep({REST_S})")
    return lines


def _servo_commands(move: PlannedMove, rows: _Rows, speed_scale: float) -> list[str]:
    """Return servoj to the position at every step of the servo's rate."""
    step_s = 1.0 / SERVO_HZ
    t = np.arange(0.0, move.duration_s / speed_scale, step_s)
    poses = np.column_stack([np.interp(t, rows.t, column) for column in rows.q.T])
    lines = [
        f"  servoj({_numbers(pose)}, t={step_s}, lookahead_time=0.1, gain=300)"
        for pose in poses
    ]
    return [*lines, "  stopj(1.0)"]


def _numbers(values: Array) -> str:
    return f"[{', '.join(f'{x:.{DECIMALS}f}' for x in values)}]"
