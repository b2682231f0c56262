"""Inspection of logs, one after the other, and of the set."""

import difflib
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.findings import found, located, verdict_of
from seqid_cli.inspect.guess import guess, stand_in
from seqid_cli.inspect.imu.readings import layout_findings
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.parts import Gathered, Inspected, serve_together
from seqid_cli.inspect.progress import Progress
from seqid_cli.logs.contents import Survey, survey
from seqid_cli.logs.pieces import read_parts
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.read import TorqueLackingError
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.logs.tables.table import missing_columns
from seqid_cli.params.document import now, tool
from seqid_cli.params.results.inspection import (
    INSPECTION_SCHEMA,
    InspectedLog,
    InspectionFile,
    InspectionFinding,
)
from seqid_cli.robot.types import Robot


def inspect_logs(
    paths: Sequence[Path],
    robot: Robot | None = None,
    *,
    time_source: TimeSource = "header",
    on_progress: Callable[[Progress], None] | None = None,
) -> InspectionFile:
    """Inspect logs one after the other, and the set of them; see `inspect`.

    The findings are those of the robot file and of the set of logs, then each log's.
    """
    inspected = []
    for done, path in enumerate(paths):
        if on_progress is not None:
            on_progress(Progress("reading", done, len(paths), str(path)))
        with local_copy(path) as file:
            one = inspect_log(file, robot, time_source=time_source)
        if file is not path:
            log = structs.replace(one.log, path=str(path))
            one = Inspected(log, located(one.findings, path))
        inspected.append(one)
    logs = [one.log for one in inspected]
    logs = logs if robot is None else serve_together(logs)
    findings = [*layout_findings(robot)] if robot is not None else []
    first: dict[str, str] = {}
    for log in logs:
        if log.sha256 and first.setdefault(log.sha256, log.path) != log.path:
            text = f"has the same content as {first[log.sha256]}"
            findings += located([found("duplicate_log", text)], log.path)
    findings += [finding for one in inspected for finding in one.findings]
    return InspectionFile(
        schema=INSPECTION_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot.name if robot else "",
        verdict=verdict_of(findings),
        logs=logs,
        findings=findings,
        advice=_advice(logs, findings, robot),
    )


def inspect_log(
    path: Path, robot: Robot | None = None, *, time_source: TimeSource = "header"
) -> Inspected:
    """Inspect one log; see `inspect_logs`."""
    try:
        surveyed = survey(path)
    except InputError as error:
        return _unreadable(path, error)
    inspected, problem = None, None
    if robot is not None:
        missing, findings = missing_imus(robot, surveyed)
        try:
            inspected = _read(path, robot, surveyed, findings, time_source, modelled=True)
        except InputError as error:
            problem = error
    if inspected is None:
        missing, inspected = _guessed(path, surveyed, robot, problem, time_source)
    names = [channel.name for channel in surveyed.channels]
    log = structs.replace(inspected.log, channels=names, missing=missing)
    return Inspected(log, inspected.findings)


def _guessed(
    path: Path,
    surveyed: Survey,
    robot: Robot | None,
    problem: InputError | None,
    time_source: TimeSource,
) -> tuple[dict[str, str], Inspected]:
    """Inspect a log without a robot file, or one that it does not fit; first what this lacks."""
    guessed = guess(surveyed)
    missing: dict[str, str] = {}
    findings: list[InspectionFinding] = []
    if robot is not None and problem is not None:
        missing, findings = missing_joints(robot, guessed.joints)
        findings = [structs.replace(f, remedy=problem.hint or f.remedy) for f in findings]
        if not findings:
            text = problem.message
            findings = [structs.replace(found("channel_missing", text), remedy=problem.hint)]
    try:
        if not guessed.joints:
            if nameless([channel.name for channel in surveyed.channels]):
                raise missing_columns(str(path), [], [c.name for c in surveyed.channels])
            raise InputError(
                "no joint positions were found by the names in it: "
                + (", ".join(channel.name for channel in surveyed.channels[:12]) or "nothing"),
                hint="Write the robot file by hand, its [channels] naming the column of each joint "
                'in chain order (position = ["...", "..."], current = [...]), and give it with -r.',
            )
        alone = stand_in(guessed, source=path)
        try:
            return missing, _read(path, alone, surveyed, findings, time_source, modelled=False)
        except TorqueLackingError as lacking:
            if guessed.patterns:  # of columns by the joints' order
                raise
            driven = tuple(name for name in guessed.joints if name not in lacking.joints)
            alone = stand_in(replace(guessed, joints=driven), source=path)
            text = "neither torque nor current is logged, but of other joints; it is left out"
            findings += [found("torque_missing", text, joint=name) for name in lacking.joints]
            return missing, _read(path, alone, surveyed, findings, time_source, modelled=False)
    except InputError as error:
        kept = [f for f in findings if f.joint]
        return missing, _unreadable(path, problem or error, surveyed.format, kept)


def _read(
    path: Path,
    robot: Robot,
    surveyed: Survey,
    before: Sequence[InspectionFinding],
    time_source: TimeSource,
    *,
    modelled: bool,
) -> Inspected:
    """Inspect a log that the robot fits, part by part; a short one is one part."""
    gathered, begun = Gathered(robot, modelled), None
    for parts in read_parts(path, robot, time_source=time_source, failed=gathered.failed):
        data = LogData(*parts, robot, modelled, begun)
        begun = int(data.joints.stamp_ns[0]) if begun is None else begun
        gathered.push(data)
        del parts, data  # they are large, and the next ones come
    return gathered.log(path, surveyed.format, before)


def _unreadable(
    path: Path, error: InputError, form: str = "", known: Sequence[InspectionFinding] = ()
) -> Inspected:
    finding = found("unreadable", error.message)
    if error.hint:
        finding = structs.replace(finding, remedy=error.hint)
    log = InspectedLog(path=str(path), sha256="", format=form, verdict="unreadable")
    return Inspected(log, located((*known, finding), path))


def _advice(
    logs: Sequence[InspectedLog], findings: Sequence[InspectionFinding], robot: Robot | None
) -> list[str]:
    """Return the next step: the first error's remedy, else the first stage that the logs serve."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        first = errors[0]
        place = f"{first.joint}: " if first.joint else ""
        return [f"first [{first.code}] {place}{first.remedy}"]
    if robot is None:
        return ["seqid init LOG --urdf FILE -o robot.toml, then inspect again with -r robot.toml"]
    there = {stage for log in logs for stage in log.serves}
    stage = "friction" if "friction" in there else "simultaneous"
    return [f"seqid {stage} LOG... -r {robot.source} -o {stage}.json"] if there else []


def _lacking(
    names: Iterable[str], there: Iterable[str], known: Container[str], *, cutoff: float
) -> dict[str, str]:
    """Names that are not there, and the unknown one nearest to each in any case, if any is near."""
    there = [*there]
    lower = {other.lower(): other for other in there if other not in known}
    found: dict[str, str] = {}
    for name in names:
        if name not in there:
            close = difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=cutoff)
            found[name] = lower[close[0]] if close else ""
    return found


def missing_imus(robot: Robot, survey: Survey) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find IMUs that a log lacks; a finding where an unknown name in it is very near."""
    names = (channel.name for channel in survey.channels)
    parted = [name for name in names if "." in name or "/" in name]
    ends = (name.strip("/").rsplit("/" if "/" in name else ".", 1) for name in parted)
    prefixes = dict.fromkeys(end[0] for end in ends)
    imus = [imu.name for imu in robot.imus]
    missing = _lacking(imus, prefixes, {*robot.joint_names, *imus}, cutoff=0.8)
    texts = {imu: f"the log has no IMU {imu!r}, but {near!r}" for imu, near in missing.items()}
    return missing, [
        found("channel_missing", texts[imu], joint=imu, channel=near)
        for imu, near in missing.items()
        if near
    ]


def missing_joints(
    robot: Robot, joints: tuple[str, ...]
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find joints of the robot file that a log lacks, with the nearest name that it has."""
    missing = _lacking(robot.joint_names, joints, robot.joint_names, cutoff=0.5)
    findings = []
    for name, near in missing.items():
        text = f"the log has no joint {name!r}" + (f"; nearest: {near!r}" if near else "")
        findings.append(found("channel_missing", text, joint=name, channel=near))
    return missing, findings
