"""An inspection on the screen: the verdict first, then logs, joints, moves, findings."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.params.results.inspection import InspectedLog, InspectionFile, InspectionFinding
from seqid_cli.params.results.tables import values

_WORDS = {
    "good": "nothing wrong was found",
    "usable": "with warnings",
    "faulty": "something is wrong: see the errors",
    "unreadable": "a log cannot be read",
}
SHOWN_JITTER = 0.01
_STAGES = ("friction", "gravity", "imu-calib", "inertia")
_SHOWN = 3  # logs that are shown in detail without -v
_LISTED = 12  # logs that have a line each without -v


def show_inspection(screen: Screen, file: InspectionFile) -> None:
    """Print the verdict, a line per log, the findings, and what moves."""
    count = f"{len(file.logs)} log" + ("s" if len(file.logs) != 1 else "")
    screen.result(f"verdict: {file.verdict} - {_WORDS[file.verdict]} ({count})")
    _logs(screen, file.logs)
    _serves(screen, file.logs)
    _findings(screen, file.findings)
    readable = [log for log in file.logs if log.joints]
    detailed = readable if screen.verbose or len(readable) <= _SHOWN else []
    for log in detailed:
        _details(screen, log)
    if readable and not detailed:
        screen.note("joints and moves of each log: add -v")
    lacking = [x for x in file.planned if x.status != "recorded"]
    rows = [(x.move, x.stage, x.status, x.reason or None, x.log or None) for x in lacking]
    titles = "still to record | stage | status | why | log"
    screen.values(values(titles, "text text text text text", rows))
    if file.planned:
        there, every = len(file.planned) - len(rows), len(file.planned)
        screen.result(f"plan: {there} of {every} moves are recorded")
    for line in file.advice:
        screen.note(f"next: {line}")


def _logs(screen: Screen, logs: Sequence[InspectedLog]) -> None:
    """Print a line per log; of many, one for those that move and serve alike."""
    folder = _common_folder([log.path for log in logs])
    if folder:
        screen.result(f"in {folder}:")
    groups: dict[object, list[InspectedLog]] = {}
    for k, log in enumerate(logs):
        moves = sum(joint.moves for joint in log.joints), len(log.joints)
        alike = (log.verdict, log.format, moves, tuple(log.serves))
        grouped = len(logs) > _LISTED and not screen.verbose
        groups.setdefault(alike if grouped else k, []).append(log)
    uneven = any(log.gaps or log.jitter >= SHOWN_JITTER for log in logs)
    formats = not uneven or len({log.format for log in logs}) > 1  # else the names tell it
    titles = f"log | verdict{' | format' * formats} | s | Hz{' | jitter | gaps' * uneven}"
    kinds = f"text text{' text' * formats} number4 text{' share count' * uneven} text text"
    rows: list[list[object]] = []
    for own in groups.values():
        first, more = own[0], f" and {len(own) - 1} more" if len(own) > 1 else ""
        rate = number(median(log.rate_hz for log in own), 4 if more else 5)
        jitter = (max(log.jitter for log in own), sum(len(log.gaps) for log in own))
        moving = f"{sum(joint.moves for joint in first.joints)} of {len(first.joints)}"
        name: list[object] = [first.path.removeprefix(folder) + more, first.verdict]
        name += [first.format or None] if formats else []
        sizes = [sum(log.seconds for log in own), rate, *(jitter if uneven else ())]
        rows.append([*name, *sizes, moving, ", ".join(first.serves) or None])
    screen.values(values(f"{titles} | moving | serves", kinds, rows))


def _serves(screen: Screen, logs: Sequence[InspectedLog]) -> None:
    """Say what several logs serve for as a whole, and which joints they leave out."""
    if len(logs) < 2 or not any(log.serves for log in logs):
        return
    counts = Counter(stage for log in logs for stage in log.serves)
    texts = [f"{x} ({counts[x]} log{'s' * (counts[x] > 1)})" for x in _STAGES if counts[x]]
    screen.result(f"as a whole they serve {', '.join(texts)}")
    alone = {move.joint for log in logs if "friction" in log.serves for move in log.moves}
    names = dict.fromkeys(joint.name for log in logs for joint in log.joints)
    lacking = [name for name in names if name not in alone]
    if alone and lacking:
        screen.result(f"no log moves this joint by itself at constant speed: {', '.join(lacking)}")


def _common_folder(paths: Sequence[str]) -> str:
    """Return the folder, with its separator, that several logs lie in; else nothing."""
    try:
        folder = os.path.commonpath([Path(path).parent for path in paths]) + os.sep
    except ValueError:  # absolute paths and relative ones, or several drives
        return ""
    return folder if len(paths) > 1 and all(path.startswith(folder) for path in paths) else ""


def _findings(screen: Screen, findings: Sequence[InspectionFinding]) -> None:
    """Print findings, the gravest first; what several logs or joints share comes once."""
    order = {"error": 0, "warning": 1, "note": 2}
    shared: dict[tuple[str, str], list[InspectionFinding]] = {}
    for item in sorted(findings, key=lambda finding: order[finding.severity]):
        alike = re.sub("-?[0-9][0-9.e+-]*", "#", _message(item).replace(item.joint or "\0", ""))
        key = (item.code, item.log + item.joint + item.message if screen.verbose else alike)
        shared.setdefault(key, []).append(item)
    for group in shared.values():
        first, logs = group[0], {item.log for item in group}
        place = [first.log + (f" (and {len(logs) - 1} more logs)" if len(logs) > 1 else "")]
        place.append(", ".join(dict.fromkeys(item.joint for item in group if item.joint)))
        place.append(first.channel if len({item.channel for item in group}) == 1 else "")
        text = ": ".join([*filter(None, place), _message(first)])
        screen.result(f"{first.severity} [{first.code}] {text}")
        screen.result(f"    {first.remedy}")


def _message(finding: InspectionFinding) -> str:
    return finding.message.removeprefix(f"{finding.joint}: ")


def _details(screen: Screen, log: InspectedLog) -> None:
    screen.result(f"\n{log.path}")
    if log.log_minus_header_s is not None:
        screen.result(f"logged {number(1e3 * log.log_minus_header_s)} ms after the header stamp")
    joints = []
    for x in log.joints:
        motion = (x.low, x.high, x.top_speed if x.moves else None, x.encoder_step)
        warmth = " to ".join(f"{end:.0f}" for end in x.temperature or ()) or None
        effort = (x.effort or None, x.effort_rms)
        joints.append((x.name, "yes" if x.moves else "no", *motion, *effort, warmth))
    titles = "joint | moves | from | to | top speed | encoder step | effort | RMS | degC"
    screen.values(values(titles, "text text number number number number text number text", joints))
    moves = [(x.joint, x.forward, x.backward, x.slowest, x.fastest, x.postures) for x in log.moves]
    titles = "constant velocity | forward | backward | slowest | fastest | postures"
    screen.values(values(titles, "text count count number number count", moves))
    if log.moving_together:
        screen.result(f"moving together: {', '.join(log.moving_together)}")
    imus = []
    for imu in log.imus:
        delay = None if imu.delay_s is None else number(1e3 * imu.delay_s, 2)
        gyro = "yes" if imu.gyro else "no"
        imus.append((imu.name, imu.accelerometers, gyro, imu.rate_hz, imu.rest_norm, delay))
    titles = "imu | accelerometers | gyro | Hz | m/s^2 at rest | delay ms"
    screen.values(values(titles, "text count text number5 number4 number", imus))
    for name, near in log.missing.items():
        screen.result(f"not in this log: {name}" + (f" (nearest: {near})" if near else ""))
