"""Files of planned moves that controllers and people read.

Per move a CSV table, a ROS 2 `trajectory_msgs/JointTrajectory` as the YAML of a
FollowJointTrajectory goal, and for six revolute joints a URScript. Slowed down by a
factor s, times are t / s, speeds s v, accelerations s^2 a.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from seqid_cli.motion.planned import RATE_HZ, REST_S, sampled
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
    """Write all files into a folder; return the moves with the names of their CSV files."""
    names = robot.joint_names
    kinds = {".csv": _csv, ".yaml": _yaml}
    if robot.n == 6 and not robot.chain.prismatic.any():
        kinds[".script"] = _urscript
    for move in moves:
        for suffix, text_of in kinds.items():
            write_text_atomic(
                folder / f"{move.name}{suffix}", text_of(move, names, speed_scale)
            )
    return [msgspec.structs.replace(move, file=f"{move.name}.csv") for move in moves]


def _rows(
    move: PlannedMove, names: Sequence[str], speed_scale: float, rate_hz: float
) -> tuple[Array, Array, Array, Array]:
    """Times, positions, speeds and accelerations of the slowed move, rounded.

    Of constant speed, and of rest, only the ends: the rows between lie on a straight
    line.
    """
    t, q, dq, ddq = sampled(move, names, rate_hz)
    changed = ddq.any(axis=1) | np.diff(dq, axis=0, prepend=np.nan).any(axis=1)
    bent = np.pad(changed, 1, constant_values=True)
    kept = bent[:-2] | bent[1:-1] | bent[2:]
    slowed = t / speed_scale, q, speed_scale * dq, speed_scale**2 * ddq
    # no minus zeros
    t, q, dq, ddq = (np.round(x[kept], DECIMALS) + 0.0 for x in slowed)
    return t, q, dq, ddq


def _csv(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    kinds = ("position", "velocity", "acceleration")
    head = ",".join(["time", *(f"{kind}_{name}" for kind in kinds for name in names)])
    rows = np.column_stack(_rows(move, names, speed_scale, RATE_HZ))
    text = "\n".join(",".join(f"{x:.10g}" for x in row) for row in rows)
    return f"{head}\n{text}\n"


def _yaml(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    quoted = ", ".join(f'"{name}"' for name in names)
    lines = [f"trajectory:\n  joint_names: [{quoted}]\n  points:"]
    leads = ("  - positions", "    velocities", "    accelerations")
    for t, *states in zip(*_rows(move, names, speed_scale, POINT_HZ), strict=True):
        for lead, values in zip(leads, states, strict=True):
            lines.append(f"{lead}: {_numbers(values)}")
        sec, nano = divmod(round(t * 1e9), 1_000_000_000)
        lines.append(f"    time_from_start: {{sec: {sec}, nanosec: {nano}}}")
    return "\n".join(lines) + "\n"


def _urscript(move: PlannedMove, names: Sequence[str], speed_scale: float) -> str:
    """A program: a slow way to the start, then servoj; strokes as movej of their speed."""
    planned, q, _, _ = _rows(move, names, speed_scale, SERVO_HZ)
    program = re.sub(r"[^A-Za-z0-9]", "_", move.name)
    lines = [
        f"def {program}():",
        f"  movej({_numbers(q[0])}, a=0.3, v=0.2)",
        "  sleep(1)",
    ]
    if move.strokes:
        j = list(names).index(move.joints[0])
        for stroke in move.strokes:
            pose = q[0].copy()
            pose[j] = stroke.end
            a, v = stroke.acceleration * speed_scale**2, stroke.speed * speed_scale
            lines += [
                f"  movej({_numbers(pose)}, a={a:.6g}, v={v:.6g})",
                f"  sleep({REST_S})",
            ]
    else:
        step = 1.0 / SERVO_HZ
        t = np.arange(0.0, move.duration_s / speed_scale, step)
        every = np.column_stack([np.interp(t, planned, column) for column in q.T])
        lines += [
            f"  servoj({_numbers(x)}, t={step}, lookahead_time=0.1, gain=300)"
            for x in every
        ]
        lines.append("  stopj(1.0)")
    return "\n".join([*lines, "end", f"{program}()"]) + "\n"


def _numbers(values: Array) -> str:
    return f"[{', '.join(f'{x:.{DECIMALS}f}' for x in values)}]"
