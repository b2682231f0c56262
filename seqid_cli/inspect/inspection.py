"""Inspection of logs, each by itself and the set of them: logs in, the document out."""

import difflib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.findings import finding_of, located, verdict_of
from seqid_cli.inspect.guess import NOTHING_KNOWN, Guess, Known, guess, stand_in
from seqid_cli.inspect.imu.readings import layout_findings
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.parts import Gathered, Inspected
from seqid_cli.inspect.progress import Progress
from seqid_cli.inspect.serves import serve_together
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.contents import LogContents, contents_of
from seqid_cli.logs.left_out import in_logged_posture, standing_joints
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.pieces import read_parts
from seqid_cli.logs.read import TorqueLackingError
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.storage.files import time_of_log, unchanged
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.logs.tables.table import missing_columns
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import head, used_settings
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
    settings: InspectSettings = InspectSettings(),
    reading: Reading = HEADER_STAMPS,
    on_progress: Callable[[Progress], None] | None = None,
) -> InspectionFile:
    """Inspect logs, and what they make together.

    Parameters
    ----------
    paths : sequence of Path
        Logs of any format that can be read.
    robot : Robot, optional
        The arm; joints are guessed without it.
    settings : InspectSettings
        Numbers that decide.
    reading : Reading
        By which stamps logs are read, and which part of them.
    on_progress : callable, optional
        Given a `Progress` before each log.

    Returns
    -------
    InspectionFile
        Findings are those of the robot file and of the set, then of each log.
    """
    logs: list[InspectedLog] = []
    times_s: list[float] = []
    findings_of_logs: list[InspectionFinding] = []
    for done, path in enumerate(paths):
        if on_progress is not None:
            on_progress(
                Progress(state="reading", done=done, total=len(paths), log=str(path))
            )
        with local_copy(path) as file:
            inspected = inspect_log(file, robot, settings=settings, reading=reading)
        # A log on object storage is named by its address, not by the copy.
        logs.append(structs.replace(inspected.log, path=str(path)))
        findings_of_logs += located(inspected.findings, path)
        time = time_of_log(path, inspected.stamps_s)
        if time is not None:
            times_s.append(time)
    if robot is not None:
        logs = serve_together(logs)

    findings = [*layout_findings(robot)] if robot is not None else []
    findings += _duplicates(logs)
    findings += findings_of_logs
    return InspectionFile(
        **head(INSPECTION_SCHEMA, created_from((), times_s)),
        robot=robot.name if robot else "",
        verdict=verdict_of(findings),
        logs=logs,
        findings=findings,
        advice=_advice(logs, findings, robot),
        settings=used_settings(settings),
    )


def _duplicates(logs: Sequence[InspectedLog]) -> list[InspectionFinding]:
    """Return a finding for each log with the same content as an earlier one."""
    findings: list[InspectionFinding] = []
    first_path: dict[str, str] = {}
    for log in logs:
        if not log.sha256:
            continue
        path = first_path.setdefault(log.sha256, log.path)
        if path != log.path:
            text = f"has the same content as {path}"
            findings += located([finding_of("duplicate_log", text)], log.path)
    return findings


def inspect_log(
    path: Path,
    robot: Robot | None = None,
    *,
    settings: InspectSettings = InspectSettings(),
    reading: Reading = HEADER_STAMPS,
    known: Known = NOTHING_KNOWN,
) -> Inspected:
    """Inspect one log.

    Parameters
    ----------
    path : Path
        A log of any format that can be read.
    robot : Robot, optional
        The arm; joints are guessed without it, and where the log does not have them.
    settings : InspectSettings
        Numbers that decide.
    reading : Reading
        By which stamps logs are read, and which part of them.
    known : Known
        What is known of the robot, for a guess.

    Returns
    -------
    Inspected
        A log that cannot be read has the finding `unreadable`.
    """
    try:
        log = LogFile.at(path, reading=reading)
        # It is looked at more than once: what it holds, then what its channels say.
        with unchanged(log.file, log.state):
            return _inspected(path, robot, settings, reading, known)
    except InputError as error:
        return _unreadable(path, error)


def _inspected(
    path: Path,
    robot: Robot | None,
    settings: InspectSettings,
    reading: Reading,
    known: Known,
) -> Inspected:
    """Inspect one log, whose content can be listed; as `inspect_log`."""
    contents = contents_of(path, glance=True)
    reader = _Reader(
        path=path,
        form=contents.format,
        reading=reading,
        settings=settings,
    )
    names = list(contents.channels)
    missing: dict[str, str] = {}
    problem: InputError | None = None
    inspected: Inspected | None = None
    if robot is not None:
        missing, findings = _missing_imus(robot, names)
        try:
            posture, left_out = _of_joints_left_out(path, robot, reading)
            inspected = reader.inspect(posture, [*findings, *left_out], modelled=True)
        except InputError as error:
            problem = error

    # The log says more of itself than that it does not fit the robot file: without one,
    # or where it does not fit, joints are guessed.
    if inspected is None:
        misfit = None if robot is None or problem is None else (robot, problem)
        missing, inspected = _by_guess(reader, contents, known, misfit)
        if not contents.complete and not _knows_all(contents, inspected):
            contents = contents_of(path)
            missing, inspected = _by_guess(reader, contents, known, misfit)
    log = structs.replace(inspected.log, channels=names, missing=missing)
    return inspected._replace(log=log)


def _knows_all(contents: LogContents, inspected: Inspected) -> bool:
    """Return whether a log has no other joints than those that its contents name."""
    return bool(inspected.names) and inspected.names <= set(contents.joints)


@dataclass(frozen=True, kw_only=True)
class _Reader:
    """One log that is read part by part, as often as robots are tried on it."""

    path: Path
    form: str
    reading: Reading
    settings: InspectSettings

    def inspect(
        self, robot: Robot, findings: Sequence[InspectionFinding], *, modelled: bool
    ) -> Inspected:
        """Inspect the log by a robot.

        Parameters
        ----------
        robot : Robot
            The arm, or one that is guessed from the log.
        findings : sequence of InspectionFinding
            Findings from before the log is read.
        modelled : bool
            Whether the robot's geometry is known.
        """
        gathered = Gathered(robot=robot, modelled=modelled)
        first_stamp_ns = None
        names: tuple[str, ...] = ()
        log = LogFile.at(self.path, reading=self.reading)
        for recording, raw in read_parts(log, robot, failed=gathered.failed):
            data = LogData(
                recording=recording,
                raw=raw,
                robot=robot,
                modelled=modelled,
                first_stamp_ns=first_stamp_ns,
                settings=self.settings,
            )
            if first_stamp_ns is None:
                first_stamp_ns = int(data.joints.stamp_ns[0])
            gathered.push(data)
            names = raw.names
            del recording, raw, data  # they are large, and the next ones come
        inspected = gathered.log(self.path, self.form, findings)
        # Of parts of no use the names are not known.
        return inspected._replace(names=frozenset(() if gathered.lost else names))


def _of_joints_left_out(
    path: Path, robot: Robot, reading: Reading
) -> tuple[Robot, list[InspectionFinding]]:
    """Return the robot with joints that its file leaves out as they stand in a log."""
    left_out = standing_joints(path, robot, reading)
    findings = [
        finding_of(
            "joint_left_out" if standing.moves else "joint_stands",
            standing.message,
            standing.joint.name,
        )
        for standing in left_out
        if standing.message
    ]
    locked = [standing for standing in left_out if not standing.moves]
    return in_logged_posture(robot, locked), findings


def _why_it_does_not_fit(
    robot: Robot, guessed: Guess, problem: InputError
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Return joints that a log lacks, with the nearest names, and the findings."""
    missing, findings = _lacking("joint", robot.joint_names, guessed.joints, 0.5)
    if not findings:
        findings = [finding_of("channel_missing", problem.message)]
    if problem.hint:
        findings = [structs.replace(f, remedy=problem.hint) for f in findings]
    return missing, findings


def _by_guess(
    reader: _Reader,
    contents: LogContents,
    known: Known,
    misfit: tuple[Robot, InputError] | None,
) -> tuple[dict[str, str], Inspected]:
    """Inspect a log by joints that are guessed.

    Parameters
    ----------
    reader : _Reader
    contents : LogContents
    known : Known
        What is known of the robot.
    misfit : (Robot, InputError), optional
        A robot that the log does not fit, and why.

    Returns
    -------
    missing : dict of str to str
        Joints of that robot which the log lacks, with the nearest names.
    inspected : Inspected
    """
    guessed = guess(contents, known)
    missing: dict[str, str] = {}
    findings = [*_topic_findings(contents)]
    if misfit is not None:
        robot, problem = misfit
        missing, findings = _why_it_does_not_fit(robot, guessed, problem)
    try:
        return missing, _inspect_guessed(reader, contents, guessed, findings)
    except InputError as error:
        of_joints = [finding for finding in findings if finding.joint]
        return missing, _unreadable(
            reader.path,
            error if misfit is None else misfit[1],
            contents.format,
            findings=of_joints,
        )


def _inspect_guessed(
    reader: _Reader,
    contents: LogContents,
    guessed: Guess,
    findings: list[InspectionFinding],
) -> Inspected:
    """Inspect a log without a robot file, or one that it does not fit."""
    if not guessed.joints:
        raise _no_joints(reader.path, list(contents.channels))
    try:
        robot = stand_in(guessed, source=reader.path)
        return reader.inspect(robot, findings, modelled=False)
    except TorqueLackingError as lacking:
        if guessed.patterns:  # of columns by the joints' order
            raise
        # Some joints have a torque and others none, such as a gripper.
        driven = tuple(name for name in guessed.joints if name not in lacking.joints)
        text = (
            "neither torque nor current is logged, but of other joints; it is left out"
        )
        for name in lacking.joints:
            findings.append(finding_of("torque_missing", text, name))
        robot = stand_in(replace(guessed, joints=driven), source=reader.path)
        return reader.inspect(robot, findings, modelled=False)


def _topic_findings(contents: LogContents) -> Iterator[InspectionFinding]:
    """Say from which topic joint states are read that none carries for sure."""
    if not contents.state_topics:
        return
    topic, *others = contents.state_topics
    text = f"no topic carries joint states for sure; they are read from {topic}"
    if others:
        text += f", not from {', '.join(others)}"
    yield structs.replace(
        finding_of("reader", text, channel=topic),
        remedy=f'Say which it is in the robot file: [channels] topic = "{topic}".',
    )


def _no_joints(path: Path, names: Sequence[str]) -> InputError:
    """Return the error of a log whose names show no joint."""
    if nameless(names):
        return missing_columns(str(path), [], names)
    listed = ", ".join(names[:12]) or "nothing"
    hint = (
        "Write the robot file by hand, its [channels] naming the column of each joint"
        ' in chain order (position = ["...", "..."], current = [...]), and give it'
        " with -r."
    )
    return InputError(
        f"no joint positions were found by the names in it: {listed}", hint=hint
    )


def _unreadable(
    path: Path,
    error: InputError,
    form: str = "",
    findings: Sequence[InspectionFinding] = (),
) -> Inspected:
    """Return a log that cannot be read, with the reason."""
    finding = finding_of("unreadable", error.message)
    finding = structs.replace(finding, remedy=error.hint or finding.remedy)
    log = InspectedLog(path=str(path), sha256="", format=form, verdict="unreadable")
    return Inspected(log, located((*findings, finding), path))


def _advice(
    logs: Sequence[InspectedLog],
    findings: Sequence[InspectionFinding],
    robot: Robot | None,
) -> list[str]:
    """Return the next step: an error's remedy, else the first stage that logs serve."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        worst = errors[0]
        place = f"{worst.joint}: " if worst.joint else ""
        return [f"first [{worst.code}] {place}{worst.remedy}"]
    if robot is None:
        return [
            "seqid init LOG --urdf FILE -o robot.toml, then inspect again with -r"
            " robot.toml"
        ]
    served = {stage for log in logs for stage in log.serves}
    if not served:
        return []
    stage = "friction" if "friction" in served else "simultaneous"
    steps = [f"seqid {stage} LOG... -r {robot.source} -o {stage}.json"]
    of_current = any(joint.effort == "current" for log in logs for joint in log.joints)
    if of_current and robot.nominal is None:
        steps.append(
            "look up that the current is in A: without inertials in the URDF no log"
            " tells its unit"
        )
    return steps


def _missing_imus(
    robot: Robot, channels: Sequence[str]
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find IMUs that a log lacks, which are no finding unless there is a near name."""
    # Columns are "imu.ax", topics "/imu/data": the name stands before the last mark.
    names = []
    for channel in channels:
        if "/" in channel:
            names.append(channel.strip("/").rsplit("/", 1)[0])
        elif "." in channel:
            names.append(channel.rsplit(".", 1)[0])
    names = list(dict.fromkeys(names))
    imus = [imu.name for imu in robot.imus]
    missing, findings = _lacking("IMU", imus, names, 0.8, robot.joint_names)
    return missing, [finding for finding in findings if finding.channel]


def _lacking(
    kind: str,
    expected: Sequence[str],
    names: Sequence[str],
    cutoff: float,
    joint_names: Sequence[str] = (),
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find expected names that a log lacks, and for each the nearest other name in it.

    `cutoff` is the least likeness of a near name, whatever its case. `joint_names` are
    of joints, and no candidates.
    """
    taken = {*expected, *joint_names}
    candidates = {name.lower(): name for name in names if name not in taken}
    missing: dict[str, str] = {}
    findings = []
    for name in expected:
        if name in names:
            continue
        close = difflib.get_close_matches(
            name.lower(), list(candidates), n=1, cutoff=cutoff
        )
        nearest = candidates[close[0]] if close else ""
        missing[name] = nearest
        text = f"the log has no {kind} {name!r}"
        if nearest:
            text += f"; nearest: {nearest!r}"
        findings.append(finding_of("channel_missing", text, name, nearest))
    return missing, findings
