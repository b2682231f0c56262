"""Inspecting logs: the one function that the command and Python users call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from seqid_cli.errors import InputError
from seqid_cli.inspect.channels import missing_imus, missing_joints
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.guess import guess, stand_in
from seqid_cli.inspect.imus import layout_findings
from seqid_cli.inspect.material import LogData, read_log
from seqid_cli.inspect.moves import (
    imu_summaries,
    joint_summaries,
    moves_of,
    serves,
    stretches_of,
    together,
)
from seqid_cli.inspect.report import Finding, InspectReport, LogReport, found
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.survey import Survey, survey
from seqid_cli.robot.types import Robot

_STAGES = ("friction", "gravity", "imu-calib", "inertia")

Progress = Callable[[int, str], None]


def inspect_logs(
    paths: Sequence[Path],
    robot: Robot | None = None,
    *,
    time_source: TimeSource = "header",
    progress: Progress | None = None,
) -> InspectReport:
    """Look through logs and say what is in them and what is wrong with them.

    Parameters
    ----------
    paths : sequence of Path
        Logs of any format that can be read.
    robot : Robot, optional
        The robot file; without it the joints are guessed, and nothing is compared with geometry.
    time_source : {"header", "log"}
        Which stamps of an MCAP log count.
    progress : callable, optional
        Called with the number of logs done and the name of the next.

    Returns
    -------
    InspectReport
        A log that cannot be read is in it with the finding `unreadable`.
    """
    logs = []
    for done, path in enumerate(paths):
        if progress is not None:
            progress(done, path.name)
        logs.append(inspect_log(path, robot, time_source=time_source))
    common = [*layout_findings(robot)] if robot is not None else []
    common += _duplicates(logs)
    findings = (*common, *(finding for log in logs for finding in log.findings))
    return InspectReport(tuple(logs), findings, _advice(logs, findings, robot))


def inspect_log(
    path: Path, robot: Robot | None = None, *, time_source: TimeSource = "header"
) -> LogReport:
    """Inspect one log; see `inspect_logs`."""
    try:
        surveyed = survey(path)
    except InputError as error:
        return _unreadable(path, error)
    names = tuple(channel.name for channel in surveyed.channels)
    problem: InputError | None = None
    if robot is not None:
        try:
            data = read_log(path, robot, modelled=True, time_source=time_source)
        except InputError as error:
            problem = error
        else:
            missing, findings = missing_imus(robot, surveyed)
            return replace(_report(path, surveyed, data, findings), channels=names, missing=missing)
    return replace(_guessed(path, surveyed, robot, problem, time_source), channels=names)


def _guessed(
    path: Path,
    surveyed: Survey,
    robot: Robot | None,
    problem: InputError | None,
    time_source: TimeSource,
) -> LogReport:
    """Inspect a log without a robot file, or one that the robot file does not fit."""
    guessed = guess(surveyed)
    missing: dict[str, str] = {}
    findings: list[Finding] = []
    if robot is not None and problem is not None:
        missing, findings = missing_joints(robot, guessed.joints)
        findings = [replace(f, remedy=problem.hint or f.remedy) for f in findings]
        if not findings:
            text = problem.message
            findings = [replace(found("channel_missing", text), remedy=problem.hint)]
    try:
        if not guessed.joints:
            raise InputError(
                "no joint positions were found by the names in it: "
                + (", ".join(channel.name for channel in surveyed.channels[:12]) or "nothing"),
                hint="Give a robot file with -r, its [channels] naming the columns.",
            )
        alone = stand_in(guessed, source=path)
        data = read_log(path, alone, modelled=False, time_source=time_source)
    except InputError as error:
        report = _unreadable(path, problem or error, form=surveyed.format)
        kept = [f for f in findings if f.joint]
        return replace(report, missing=missing, findings=_located((*kept, *report.findings), path))
    report = _report(path, surveyed, data, findings)
    return replace(report, missing=missing)


def _report(path: Path, surveyed: Survey, data: LogData, found_before: list[Finding]) -> LogReport:
    recording = data.recording
    checked = check(data)
    stretches = stretches_of(data)
    health = recording.health
    return LogReport(
        path=str(path),
        format=surveyed.format,
        samples=len(recording.t),
        seconds=float(recording.t[-1]),
        rate_hz=health.rate_hz,
        jitter=health.jitter,
        gaps=health.gaps,
        non_monotonic=health.non_monotonic,
        duplicates=health.duplicates,
        log_minus_header_s=health.log_minus_header_s,
        sha256=recording.sha256,
        joints=joint_summaries(data),
        imus=imu_summaries(data, checked.following),
        moves=moves_of(data, stretches),
        moving_together=together(data),
        serves=serves(data, stretches) if data.modelled else (),
        partial=recording.partial,
        findings=_located((*found_before, *checked.findings), path),
    )


def _unreadable(path: Path, error: InputError, form: str = "") -> LogReport:
    finding = replace(found("unreadable", error.message), log=str(path))
    if error.hint:
        finding = replace(finding, remedy=error.hint)
    return LogReport(path=str(path), format=form, findings=(finding,))


def _located(findings: Sequence[Finding], path: Path) -> tuple[Finding, ...]:
    return tuple(replace(finding, log=str(path)) for finding in findings)


def _duplicates(logs: Sequence[LogReport]) -> list[Finding]:
    first: dict[str, str] = {}
    findings = []
    for log in logs:
        if log.sha256 and first.setdefault(log.sha256, log.path) != log.path:
            text = f"has the same content as {first[log.sha256]}"
            findings.append(replace(found("duplicate_log", text), log=log.path))
    return findings


def _advice(
    logs: Sequence[LogReport], findings: Sequence[Finding], robot: Robot | None
) -> tuple[str, ...]:
    """Say what to do next."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        first = errors[0]
        place = f"{first.joint}: " if first.joint else ""
        return (f"first [{first.code}] {place}{first.remedy}",)
    if robot is None:
        return ("seqid init LOG --urdf FILE -o robot.toml, then inspect again with -r robot.toml",)
    there = {stage for log in logs for stage in log.serves}
    by_stage = [
        f"{stage}: {sum(stage in log.serves for log in logs)} logs"
        for stage in _STAGES
        if stage in there
    ]
    return ("logs for " + ", ".join(by_stage),) if by_stage else ()
