"""Inspection of logs, one after the other, and of the set: logs in, the document out."""

import difflib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.findings import found, located, verdict_of
from seqid_cli.inspect.guess import Guess, guess, stand_in
from seqid_cli.inspect.imu.readings import layout_findings
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.parts import Gathered, Inspected, serve_together
from seqid_cli.inspect.progress import Progress
from seqid_cli.logs.contents import survey
from seqid_cli.logs.left_out import in_logged_posture, standing_joints
from seqid_cli.logs.pieces import read_parts
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.read import TorqueLackingError
from seqid_cli.logs.storage.files import time_of_log
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.logs.tables.table import missing_columns
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import head
from seqid_cli.params.results import inspection as schema
from seqid_cli.params.results.inspection import InspectedLog, InspectionFinding
from seqid_cli.robot.types import Robot

Read = Callable[[Robot, Sequence[InspectionFinding]], Inspected]


def inspect_logs(
    paths: Sequence[Path],
    robot: Robot | None = None,
    *,
    time_source: TimeSource = "header",
    on_progress: Callable[[Progress], None] | None = None,
) -> schema.InspectionFile:
    """Inspect logs; findings are of robot file and set of logs, then of each log; see `inspect`."""
    logs: list[InspectedLog] = []
    times_s: list[float] = []
    own: list[InspectionFinding] = []
    for done, path in enumerate(paths):
        if on_progress is not None:
            on_progress(Progress("reading", done, len(paths), str(path)))
        with local_copy(path) as file:
            one = inspect_log(file, robot, time_source=time_source)
        logs.append(structs.replace(one.log, path=str(path)))
        own += located(one.findings, path)
        time = time_of_log(path, one.stamps_s)
        times_s += [] if time is None else [time]
    logs = logs if robot is None else serve_together(logs)
    findings = [*layout_findings(robot)] if robot is not None else []
    first: dict[str, str] = {}
    for log in logs:
        if log.sha256 and first.setdefault(log.sha256, log.path) != log.path:
            text = f"has the same content as {first[log.sha256]}"
            findings += located([found("duplicate_log", text)], log.path)
    findings += own
    return schema.InspectionFile(
        **head(schema.INSPECTION_SCHEMA, created_from((), times_s)),
        robot=robot.name if robot else "",
        verdict=verdict_of(findings),
        logs=logs,
        findings=findings,
        advice=_advice(logs, findings, robot),
    )


def inspect_log(
    path: Path, robot: Robot | None = None, *, time_source: TimeSource = "header"
) -> Inspected:
    """Inspect one log; see `inspect`."""
    try:
        surveyed = survey(path)
    except InputError as error:
        return _unreadable(path, error)

    def read(arm: Robot, before: Sequence[InspectionFinding]) -> Inspected:
        given = robot is not None and arm.source == robot.source
        gathered, begun = Gathered(arm, given), None
        for parts in read_parts(
            path, arm, time_source=time_source, failed=gathered.failed
        ):
            data = LogData(*parts, arm, given, begun)
            begun = int(data.joints.stamp_ns[0]) if begun is None else begun
            gathered.push(data)
            del parts, data  # they are large, and the next ones come
        return gathered.log(path, surveyed.format, before)

    names = list(surveyed.channels)
    inspected, problem = None, None
    missing: dict[str, str] = {}
    if robot is not None:
        missing, findings = _missing_imus(robot, names)
        try:
            posture, left_out = _of_joints_left_out(path, robot)
            findings += left_out
            inspected = read(posture, findings)
        except InputError as error:
            problem = error
    if inspected is None:
        guessed = guess(surveyed)
        findings = []
        if robot is not None and problem is not None:
            missing, findings = _lacking(
                "joint", robot.joint_names, guessed.joints, 0.5
            )
            findings = findings or [found("channel_missing", problem.message)]
            findings = [
                structs.replace(f, remedy=problem.hint or f.remedy) for f in findings
            ]
        try:
            inspected = _guessed(path, names, guessed, findings, read)
        except InputError as error:
            kept = [f for f in findings if f.joint]
            inspected = _unreadable(path, problem or error, surveyed.format, kept)
    return inspected._replace(
        log=structs.replace(inspected.log, channels=names, missing=missing)
    )


def _of_joints_left_out(
    path: Path, robot: Robot
) -> tuple[Robot, list[InspectionFinding]]:
    """Take joints that the robot file leaves out where they stand in a log, and say so."""
    standing = standing_joints(path, robot)
    said = [
        found(
            "joint_left_out" if one.moves else "joint_stands",
            one.message,
            one.joint.name,
        )
        for one in standing
        if one.message
    ]
    return in_logged_posture(robot, [one for one in standing if not one.moves]), said


def _guessed(
    path: Path,
    names: list[str],
    guessed: Guess,
    findings: list[InspectionFinding],
    read: Read,
) -> Inspected:
    """Inspect a log without a robot file, or one that it does not fit."""
    if not guessed.joints:
        if nameless(names):
            raise missing_columns(str(path), [], names)
        told = ", ".join(names[:12]) or "nothing"
        hint = (
            "Write the robot file by hand, its [channels] naming the column of each"
            " joint in "
        )
        hint += (
            'chain order (position = ["...", "..."], current = [...]), and give it'
            " with -r."
        )
        raise InputError(
            f"no joint positions were found by the names in it: {told}", hint=hint
        )
    try:
        return read(stand_in(guessed, source=path), findings)
    except TorqueLackingError as lacking:
        if guessed.patterns:  # of columns by the joints' order
            raise
        driven = tuple(name for name in guessed.joints if name not in lacking.joints)
        text = (
            "neither torque nor current is logged, but of other joints; it is left out"
        )
        findings += [found("torque_missing", text, name) for name in lacking.joints]
        return read(stand_in(replace(guessed, joints=driven), source=path), findings)


def _unreadable(
    path: Path,
    error: InputError,
    form: str = "",
    known: Sequence[InspectionFinding] = (),
) -> Inspected:
    finding = found("unreadable", error.message)
    finding = structs.replace(finding, remedy=error.hint or finding.remedy)
    log = InspectedLog(path=str(path), sha256="", format=form, verdict="unreadable")
    return Inspected(log, located((*known, finding), path))


def _advice(
    logs: Sequence[InspectedLog],
    findings: Sequence[InspectionFinding],
    robot: Robot | None,
) -> list[str]:
    """Return the next step: the first error's remedy, else the first stage that the logs serve."""
    if first := next(
        (finding for finding in findings if finding.severity == "error"), None
    ):
        place = f"{first.joint}: " if first.joint else ""
        return [f"first [{first.code}] {place}{first.remedy}"]
    if robot is None:
        return [
            "seqid init LOG --urdf FILE -o robot.toml, then inspect again with -r"
            " robot.toml"
        ]
    there = {stage for log in logs for stage in log.serves}
    stage = "friction" if "friction" in there else "simultaneous"
    return [f"seqid {stage} LOG... -r {robot.source} -o {stage}.json"] if there else []


def _missing_imus(
    robot: Robot, channels: Sequence[str]
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find IMUs that a log lacks; it need not have them, but a very near name is a finding."""
    parted = [name for name in channels if "." in name or "/" in name]
    ends = (name.strip("/").rsplit("/" if "/" in name else ".", 1) for name in parted)
    there, imus = (
        [*dict.fromkeys(end[0] for end in ends)],
        [imu.name for imu in robot.imus],
    )
    missing, findings = _lacking("IMU", imus, there, 0.8, robot.joint_names)
    return missing, [finding for finding in findings if finding.channel]


def _lacking(
    kind: str,
    names: Sequence[str],
    there: Sequence[str],
    cutoff: float,
    known: Sequence[str] = (),
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find names that are not there, and the unknown one nearest to each in any case."""
    lower = {other.lower(): other for other in there if other not in {*names, *known}}
    missing, findings = {}, []
    for name in names:
        if name not in there:
            close = difflib.get_close_matches(
                name.lower(), list(lower), n=1, cutoff=cutoff
            )
            near = missing[name] = lower[close[0]] if close else ""
            text = f"the log has no {kind} {name!r}" + (
                f"; nearest: {near!r}" if near else ""
            )
            findings.append(found("channel_missing", text, name, near))
    return missing, findings
