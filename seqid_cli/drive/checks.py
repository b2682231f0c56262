"""Commands that show no controller, and what else of the logs a reader has to know.

A joint may have no command (a gripper that has a driver of its own), one that is an
echo of its position, or one that was resampled before it was logged. Joints that a log
has beside the robot's chain are named: what drives them is not looked for.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from seqid_cli.drive.signals import DriveSignals
from seqid_cli.errors import InputError
from seqid_cli.inspect.guess import guess
from seqid_cli.logs.commands import held_period
from seqid_cli.logs.contents import contents_of
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf import MOVABLE, UrdfJoint, read_urdf_text
from seqid_cli.typing import Array

# Of a joint's travel: no drive follows as closely, so that such a command is an echo.
ECHO = 1e-5
# Of a step of the encoder: a position that is rounded once more differs by as much.
ECHO_STEPS = 0.5
# Rows by which an echo may be early or late: a logger takes both one after the other.
ECHO_ROWS = range(-3, 4)
# Of a command's range: a bend of a straight line that is smaller is one of rounding.
BEND = 1e-6
PAUSE = 3.0  # times the usual time between two commands
FEWEST_BENDS = 10  # that tell how fast points came


def has_command(logs: Sequence[DriveSignals], joint: int) -> bool:
    """Tell whether any log holds a command of a joint."""
    return any(np.isfinite(_command(log, joint)).any() for log in logs)


def fault_of_command(logs: Sequence[DriveSignals], joint: int) -> str:
    """Say why a joint's commands show no controller; empty where they may."""
    columns = [_command(log, joint) for log in logs]
    if not has_command(logs, joint):
        return "the logs hold no command of it: log <joint>.command"
    if all(np.ptp(column[np.isfinite(column)]) == 0.0 for column in columns):
        return "its command never changes: move it"
    moves = any((log.moving[:, joint] & log.usable[:, joint]).any() for log in logs)
    if not moves:
        return "it does not move: move it by its command"
    if _is_echo(logs, joint):
        return (
            "its command is the measured position, and no command: log what the"
            " controller is asked for"
        )
    return ""


def _command(log: DriveSignals, joint: int) -> Array:
    assert log.raw.command is not None
    return np.asarray(log.raw.command[:, joint])


def _is_echo(logs: Sequence[DriveSignals], joint: int) -> bool:
    """Tell whether commands are measured positions, maybe of a row before or behind."""
    motion = max(float(np.ptp(log.raw.q[:, joint])) for log in logs)
    step = max(float(log.noise_step[joint]) for log in logs)
    allowed = max(ECHO * motion, ECHO_STEPS * step)
    return any(
        all(_difference(log, joint, rows) <= allowed for log in logs)
        for rows in ECHO_ROWS
    )


def _difference(log: DriveSignals, joint: int, rows: int) -> float:
    """Return how far a command is from the position some rows before [rad]."""
    shifted = np.roll(log.raw.q[:, joint], rows)
    used = log.moving[:, joint] & np.isfinite(_command(log, joint))
    used[: max(rows, 0)] = False
    used[len(used) + min(rows, 0) :] = False
    if not used.any():
        return 0.0
    return float(np.quantile(np.abs(_command(log, joint) - shifted)[used], 0.99))


def remarks_on_commands(
    logs: Sequence[DriveSignals], recordings: Sequence[Recording], robot: Robot
) -> list[str]:
    """Say which logs hold no command, and at which rate commands came.

    Parameters
    ----------
    logs : sequence of DriveSignals
        The logs with commands.
    recordings : sequence of Recording
        All logs.
    robot : Robot
    """
    with_commands = {log.path for log in logs}
    remarks = [
        f"{log.path} has no commanded position and is left out: log <joint>.command"
        for log in recordings
        if log.path not in with_commands
    ]
    return [*remarks, *dict.fromkeys(_remarks_on_rates(logs, robot))]


def _remarks_on_rates(logs: Sequence[DriveSignals], robot: Robot) -> Iterator[str]:
    for log in logs:
        row_ms = 1e3 / log.rate_hz
        if log.sent is not None:
            times, _ = log.sent
            gaps = np.diff(times)
            # Without pauses, in which nothing is sent.
            period_ms = 1e3 * float(gaps[gaps < PAUSE * np.median(gaps)].mean())
            yield (
                f"commands came every {period_ms:.3g} ms, rows every {row_ms:.3g} ms: a"
                " command counts until the next one"
            )
            continue
        resampled = [
            (name, period_s)
            for j, name in enumerate(robot.joint_names)
            if (period_s := resampled_period(_command(log, j), log.rate_hz))
        ]
        if resampled:
            names = ", ".join(name for name, _ in resampled)
            period_ms = 1e3 * resampled[0][1]
            yield (
                f"the commands of {names} run straight for {period_ms:.3g} ms each:"
                " they were resampled, and what the controller took in between does not"
                f" show. If it holds them, the delay is {0.5 * period_ms:.3g} ms"
                " shorter: log commands as they are sent"
            )
        elif log.command_form == "sampled":
            yield (
                f"every row of {row_ms:.3g} ms has a command, which counts as a sample"
                " of a smooth one: if the controller holds each until the next, the"
                f" delay is {0.5 * row_ms:.3g} ms shorter"
            )


def resampled_period(command: Array, rate_hz: float) -> float | None:
    """Return the time [s] that a command (N,) runs straight on; None if it does not.

    Straight lines between points that came slower than the rows bend at these points
    alone.
    """
    present = command[np.isfinite(command)]
    if len(present) < FEWEST_BENDS:
        return None
    bends = np.diff(present, 2)
    bends[np.abs(bends) <= BEND * float(np.ptp(present, axis=0))] = 0.0
    if np.count_nonzero(bends) < FEWEST_BENDS:
        return None
    rows = held_period(np.cumsum(bends))
    return None if rows is None else rows / rate_hz


def joints_beside(logs: Sequence[Path | Recording], robot: Robot) -> list[str]:
    """Name the joints that logs have beside the robot's, and why they are left out."""
    names: dict[str, None] = {}
    for log in logs:
        if isinstance(log, Recording):
            continue
        try:
            joints = guess(contents_of(log)).joints
        except InputError:
            continue
        # Joints that are only counted are not known by a name.
        if set(joints) & {*robot.joint_names, *robot.log_names}:
            names |= dict.fromkeys(joints)
    # Of joints that the robot file names and that mimic another it is said already.
    known = {*robot.joint_names, *robot.log_names}
    known |= {joint.name for joint in robot.followers}
    others = [name for name in names if name not in known]
    if not others:
        return []
    of_urdf = {} if robot.urdf is None else read_urdf_text(robot.urdf).joints
    return [f"{name} is left out: {_why(name, of_urdf.get(name))}" for name in others]


def _why(name: str, joint: UrdfJoint | None) -> str:
    """Say why a joint beside the robot's chain is left out."""
    add = f'add [[joint]] name = "{name}" to fit its drive'
    if joint is None:
        return f"it is no joint of the robot file; {add}"
    if joint.follows:
        return f"it follows {joint.follows} (mimic) and has no drive of its own"
    if joint.kind not in MOVABLE:
        return f"it is a {joint.kind} joint of the URDF"
    slides = "it slides, and " if joint.kind == "prismatic" else ""
    return f"{slides}the robot file does not name it; {add}"
