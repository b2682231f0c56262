"""Files of planned moves that controllers and people read.

Per move a CSV table, a ROS 2 `trajectory_msgs/JointTrajectory` as the YAML of a
FollowJointTrajectory goal, and for six revolute joints a URScript; all JointTrajectory messages
also stand in one MCAP file. Slowed down by a factor s, times are t / s, speeds s v, accelerations
s^2 a.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from seqid_cli.params.files import check_output, replacing, write_text_atomic, writing
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.plan.moves.strokes import REST_S
from seqid_cli.plan.moves.trajectories import RATE_HZ, sampled
from seqid_cli.robot.types import Array, Robot

POINT_HZ = 25.0  # of JointTrajectory: controllers interpolate positions, speeds, accelerations
SERVO_HZ = 50.0  # of URScript
DECIMALS = 6  # of s, rad, rad/s and rad/s^2 (m): a fifth of an arc second
_LINE = "=" * 80
DEFINITION = (
    "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n"
    f"{_LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    f"{_LINE}\nMSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\n"
    "float64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
    "builtin_interfaces/Duration time_from_start\n"
    f"{_LINE}\nMSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
)


def write_moves(
    folder: Path, moves: Sequence[PlannedMove], robot: Robot, speed_scale: float
) -> list[PlannedMove]:
    """Write all files into a folder; return the moves with the names of their CSV files."""
    names = robot.joint_names
    kinds = {".csv": _csv, ".yaml": _yaml}
    if robot.n == 6 and not robot.chain.prismatic.any():
        kinds[".script"] = _urscript
    for move in moves:
        for suffix, text_of in kinds.items():
            text = text_of(move, names, speed_scale)
            write_text_atomic(folder / f"{move.name}{suffix}", text)
    path = folder / "moves.mcap"
    check_output(path)
    with replacing(path) as temporary, writing(path), temporary.open("wb") as stream:
        _write_mcap(stream, moves, names, speed_scale)
    return [msgspec.structs.replace(move, file=f"{move.name}.csv") for move in moves]


def _rows(
    move: PlannedMove, names: Sequence[str], speed_scale: float, rate_hz: float
) -> tuple[Array, Array, Array, Array]:
    """Times, positions, speeds and accelerations of the slowed move, rounded.

    Of constant speed, and of rest, only the ends: the rows between lie on a straight line.
    """
    t, q, dq, ddq = sampled(move, names, rate_hz)
    changed = ddq.any(axis=1) | np.diff(dq, axis=0, prepend=np.nan).any(axis=1)
    bent = np.pad(changed, 1, constant_values=True)
    kept = bent[:-2] | bent[1:-1] | bent[2:]
    slowed = t / speed_scale, q, speed_scale * dq, speed_scale**2 * ddq
    t, q, dq, ddq = (np.round(x[kept], DECIMALS) + 0.0 for x in slowed)  # no minus zeros
    return t, q, dq, ddq


def _csv(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    kinds = ("position", "velocity", "acceleration")
    head = ",".join(["time", *(f"{kind}_{name}" for kind in kinds for name in names)])
    rows = np.column_stack(_rows(move, names, speed_scale, RATE_HZ))
    text = "\n".join(",".join(f"{x:.10g}" for x in row) for row in rows)
    return f"{head}\n{text}\n"


def _stamp(seconds: float) -> tuple[int, int]:
    """Whole seconds and nanoseconds."""
    whole, nano = divmod(round(seconds * 1e9), 1_000_000_000)
    return int(whole), int(nano)


def _points(
    move: PlannedMove, names: Sequence[str], speed_scale: float
) -> Iterator[tuple[tuple[int, int], dict[str, list[float]]]]:
    """Time from start and the arrays of each JointTrajectoryPoint."""
    kinds = ("positions", "velocities", "accelerations")
    for t, *states in zip(*_rows(move, names, speed_scale, POINT_HZ), strict=True):
        yield _stamp(t), {kind: x.tolist() for kind, x in zip(kinds, states, strict=True)}


def _yaml(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    quoted = ", ".join(f'"{name}"' for name in names)
    lines = [f"trajectory:\n  joint_names: [{quoted}]\n  points:"]
    for (sec, nano), arrays in _points(move, names, speed_scale):
        for lead, (kind, values) in zip(("- ", "  ", "  "), arrays.items(), strict=True):
            numbers = ", ".join(f"{x:.{DECIMALS}f}" for x in values)
            lines.append(f"  {lead}{kind}: [{numbers}]")
        lines.append(f"    time_from_start: {{sec: {sec}, nanosec: {nano}}}")
    return "\n".join(lines) + "\n"


def _write_mcap(
    stream: BinaryIO, moves: Sequence[PlannedMove], names: Sequence[str], speed_scale: float
) -> None:
    """One JointTrajectory a move, on a topic of its name, stamped by its start."""
    from mcap_ros2.writer import Writer

    start = 0.0
    writer = Writer(stream)
    schema = writer.register_msgdef("trajectory_msgs/msg/JointTrajectory", DEFINITION)
    for move in moves:
        points = [
            {**arrays, "effort": [], "time_from_start": {"sec": sec, "nanosec": nano}}
            for (sec, nano), arrays in _points(move, names, speed_scale)
        ]
        sec, nano = _stamp(start)
        header = {"stamp": {"sec": sec, "nanosec": nano}, "frame_id": ""}
        message = {"header": header, "joint_names": list(names), "points": points}
        stamp = round(start * 1e9)
        writer.write_message(f"/{move.name}", schema, message, log_time=stamp, publish_time=stamp)
        start += move.duration_s / speed_scale
    writer.finish()  # type: ignore[no-untyped-call]


def _urscript(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    """A program: a slow way to the start, then servoj; strokes as movej of their speed."""
    planned, q, _, _ = _rows(move, names, speed_scale, SERVO_HZ)
    lines = [
        f"def {_identifier(move.name)}():",
        f"  movej({_pose(q[0])}, a=0.3, v=0.2)",
        "  sleep(1)",
    ]
    if move.strokes:
        j = list(names).index(move.joints[0])
        for stroke in move.strokes:
            pose = q[0].copy()
            pose[j] = stroke.end
            a, v = stroke.acceleration * speed_scale**2, stroke.speed * speed_scale
            lines += [f"  movej({_pose(pose)}, a={a:.6g}, v={v:.6g})", f"  sleep({REST_S})"]
    else:
        step = 1.0 / SERVO_HZ
        t = np.arange(0.0, move.duration_s / speed_scale, step)
        every = np.column_stack([np.interp(t, planned, column) for column in q.T])
        lines += [f"  servoj({_pose(x)}, t={step}, lookahead_time=0.1, gain=300)" for x in every]
        lines.append("  stopj(1.0)")
    return "\n".join([*lines, "end", f"{_identifier(move.name)}()"]) + "\n"


def _identifier(name: str) -> str:
    """A name that URScript takes."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name)


def _pose(q: Array) -> str:
    return f"[{', '.join(f'{x:.{DECIMALS}f}' for x in q)}]"
