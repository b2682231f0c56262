"""An inspection on the screen: its verdict, then logs, findings, joints, moves."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.params.results.inspection import (
    InspectedLog,
    InspectionFile,
    InspectionFinding,
)
from seqid_cli.params.results.tables import values

_VERDICTS_IN_WORDS = {
    "good": "nothing wrong was found",
    "usable": "with warnings",
    "faulty": "something is wrong: see the errors",
    "unreadable": "a log cannot be read",
}
_GRAVEST_FIRST = ("error", "warning", "note")
_STAGES = ("friction", "gravity", "imu-calib", "inertia")
SHOWN_JITTER = 0.01  # of a period: from here on the column of jitter is worth its room
_DETAILED_LOGS = 3  # that are shown in detail without -v
_LISTED_LOGS = 12  # that have a line each without -v


def show_inspection(screen: Screen, file: InspectionFile) -> None:
    """Print the verdict, a line per log, the findings, and what moves."""
    words = _VERDICTS_IN_WORDS[file.verdict]
    screen.result(
        f"verdict: {file.verdict} - {words} ({_count(len(file.logs), 'log')})"
    )
    _logs(screen, file.logs)
    _serves(screen, file.logs)
    _findings(screen, file.findings)

    readable = [log for log in file.logs if log.joints]
    if screen.verbose or len(readable) <= _DETAILED_LOGS:
        for log in readable:
            _details(screen, log)
    else:
        screen.note("joints and moves of each log: add -v")

    _planned_moves(screen, file)
    for line in file.advice:
        screen.note(f"next: {line}")


def _count(number_of_things: int, thing: str) -> str:
    """Return "1 log" or "2 logs"."""
    return f"{number_of_things} {thing}" + ("" if number_of_things == 1 else "s")


def _logs(screen: Screen, logs: Sequence[InspectedLog]) -> None:
    """Print a line per log; of many, one for those that move and serve alike."""
    folder = _common_folder([log.path for log in logs])
    if folder:
        screen.result(f"in {folder}:")

    grouped = len(logs) > _LISTED_LOGS and not screen.verbose
    groups: dict[object, list[InspectedLog]] = {}
    for k, log in enumerate(logs):
        row_of_log: object = k
        if grouped:
            serves = tuple(log.serves)
            row_of_log = (log.verdict, log.format, _moving_joints(log), serves)
        groups.setdefault(row_of_log, []).append(log)

    uneven = any(log.gaps or log.jitter >= SHOWN_JITTER for log in logs)
    # Names tell the format; where they share it, jitter and gaps have the room.
    with_format = not uneven or len({log.format for log in logs}) > 1
    kind_of_column = {"log": "text", "verdict": "text"}
    if with_format:
        kind_of_column["format"] = "text"
    kind_of_column |= {"s": "number4", "Hz": "text"}
    if uneven:
        kind_of_column |= {"jitter": "share", "gaps": "count"}
    kind_of_column |= {"moving": "text", "serves": "text"}

    rows = []
    for group in groups.values():
        first = group[0]
        further_logs = f" and {len(group) - 1} more" if len(group) > 1 else ""
        rate_hz = median(log.rate_hz for log in group)
        row: list[object] = [
            first.path.removeprefix(folder) + further_logs,
            first.verdict,
        ]
        if with_format:
            row.append(first.format or None)
        row.append(sum(log.seconds for log in group))
        row.append(number(rate_hz, 4 if further_logs else 5))
        if uneven:
            row.append(max(log.jitter for log in group))
            row.append(sum(len(log.gaps) for log in group))
        row.append(_moving_joints(first))
        row.append(", ".join(first.serves) or None)
        rows.append(row)
    titles = " | ".join(kind_of_column)
    kinds = " ".join(kind_of_column.values())
    screen.values(values(titles, kinds, rows))


def _moving_joints(log: InspectedLog) -> str:
    return f"{sum(joint.moves for joint in log.joints)} of {len(log.joints)}"


def _serves(screen: Screen, logs: Sequence[InspectedLog]) -> None:
    """Say what several logs serve for as a whole, and which joints they leave out."""
    if len(logs) < 2 or not any(log.serves for log in logs):
        return
    counts = Counter(stage for log in logs for stage in log.serves)
    stages = [
        f"{stage} ({_count(counts[stage], 'log')})"
        for stage in _STAGES
        if counts[stage]
    ]
    screen.result(f"as a whole they serve {', '.join(stages)}")

    moving_alone = {
        move.joint for log in logs if "friction" in log.serves for move in log.moves
    }
    names = dict.fromkeys(joint.name for log in logs for joint in log.joints)
    lacking = [name for name in names if name not in moving_alone]
    if moving_alone and lacking:
        joints = ", ".join(lacking)
        screen.result(f"no log moves this joint by itself at constant speed: {joints}")


def _common_folder(paths: Sequence[str]) -> str:
    """Return the folder, with its separator, that several logs lie in; else nothing."""
    if len(paths) < 2:
        return ""
    try:
        folder = os.path.commonpath([Path(path).parent for path in paths]) + os.sep
    except ValueError:  # absolute paths and relative ones, or several drives
        return ""
    return folder if all(path.startswith(folder) for path in paths) else ""


def _findings(screen: Screen, findings: Sequence[InspectionFinding]) -> None:
    """Print findings, the gravest first, and once where logs or joints share them."""
    shared: dict[tuple[str, str], list[InspectionFinding]] = {}
    for finding in sorted(findings, key=lambda x: _GRAVEST_FIRST.index(x.severity)):
        if screen.verbose:
            subject = finding.log + finding.joint + finding.message
        else:
            subject = _message_of_any(finding)
        shared.setdefault((finding.code, subject), []).append(finding)

    for group in shared.values():
        first = group[0]
        logs = {finding.log for finding in group}
        further_logs = f" (and {len(logs) - 1} more logs)" if len(logs) > 1 else ""
        joints = dict.fromkeys(finding.joint for finding in group if finding.joint)
        channels = {finding.channel for finding in group}
        place = (
            f"{first.log}{further_logs}",
            ", ".join(joints),
            first.channel if len(channels) == 1 else "",
        )
        text = ": ".join([*filter(None, place), _message(first)])
        screen.result(f"{first.severity} [{first.code}] {text}")
        screen.result(f"    {first.remedy}")


def _message(finding: InspectionFinding) -> str:
    """Return what was found, without the joint that its place names."""
    return finding.message.removeprefix(f"{finding.joint}: ")


def _message_of_any(finding: InspectionFinding) -> str:
    """Return what was found without its joint and its numbers: alike for several."""
    text = _message(finding)
    if finding.joint:
        text = text.replace(finding.joint, "")
    return re.sub("-?[0-9][0-9.e+-]*", "#", text)


def _details(screen: Screen, log: InspectedLog) -> None:
    """Print what moves in a log, what its IMUs show, and what it lacks."""
    screen.result(f"\n{log.path}")
    if log.log_minus_header_s is not None:
        delay_ms = number(1e3 * log.log_minus_header_s)
        screen.result(f"logged {delay_ms} ms after the header stamp")
    _joints(screen, log)
    _commands(screen, log)
    _constant_velocity_moves(screen, log)
    if log.moving_together:
        screen.result(f"moving together: {', '.join(log.moving_together)}")
    _imus(screen, log)
    for name, nearest in log.missing.items():
        likely = f" (nearest: {nearest})" if nearest else ""
        screen.result(f"not in this log: {name}{likely}")


def _joints(screen: Screen, log: InspectedLog) -> None:
    rows = []
    for joint in log.joints:
        ends = joint.temperature or ()
        row = (
            joint.name,
            "yes" if joint.moves else "no",
            joint.low,
            joint.high,
            joint.top_speed if joint.moves else None,
            joint.encoder_step,
            joint.effort or None,
            joint.effort_rms,
            " to ".join(f"{end:.0f}" for end in ends) or None,
        )
        rows.append(row)
    titles = (
        "joint | moves | from | to | top speed | encoder step | effort | RMS | degC"
    )
    kinds = "text text number number number number text number text"
    screen.values(values(titles, kinds, rows))


def _commands(screen: Screen, log: InspectedLog) -> None:
    rows = []
    for joint in log.joints:
        command = joint.command
        if command is None:
            continue
        lag_ms = None if command.lag_s is None else 1e3 * command.lag_s
        error_ms = None if command.lag_std_s is None else 1e3 * command.lag_std_s
        at_limit = None if command.saturated is None else percent(command.saturated)
        row = (
            joint.name,
            command.form,
            command.mode or None,
            lag_ms,
            error_ms,
            at_limit,
        )
        rows.append(row)
    titles = "command of | logged as | control | lag ms | error ms | at torque limit"
    screen.values(values(titles, "text text text number number text", rows))


def _constant_velocity_moves(screen: Screen, log: InspectedLog) -> None:
    rows = [
        (
            move.joint,
            move.forward,
            move.backward,
            move.slowest,
            move.fastest,
            move.postures,
        )
        for move in log.moves
    ]
    titles = "constant velocity | forward | backward | slowest | fastest | postures"
    screen.values(values(titles, "text count count number number count", rows))


def _imus(screen: Screen, log: InspectedLog) -> None:
    rows = []
    for imu in log.imus:
        delay_ms = None if imu.delay_s is None else number(1e3 * imu.delay_s, 2)
        row = (
            imu.name,
            imu.accelerometers,
            "yes" if imu.gyro else "no",
            imu.rate_hz,
            imu.rest_norm,
            delay_ms,
        )
        rows.append(row)
    titles = "imu | accelerometers | gyro | Hz | m/s^2 at rest | delay ms"
    screen.values(values(titles, "text count text number5 number4 number", rows))


def _planned_moves(screen: Screen, file: InspectionFile) -> None:
    """Print the moves of a plan that are still to record, and how many are recorded."""
    lacking = [move for move in file.planned if move.status != "recorded"]
    rows = [
        (move.move, move.stage, move.status, move.reason or None, move.log or None)
        for move in lacking
    ]
    titles = "still to record | stage | status | why | log"
    screen.values(values(titles, "text text text text text", rows))
    if file.planned:
        recorded = len(file.planned) - len(lacking)
        screen.result(f"plan: {recorded} of {len(file.planned)} moves are recorded")
