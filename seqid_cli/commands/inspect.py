"""`seqid inspect`: what is in some logs and what is wrong with them."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED
from seqid_cli.commands.options import Clock, Logs, Output
from seqid_cli.commands.progress import ProgressLine
from seqid_cli.commands.render import Screen, screen_of
from seqid_cli.commands.show_inspection import show_inspection
from seqid_cli.commands.visible import visible
from seqid_cli.logs.open import expand
from seqid_cli.params.document import now, tool
from seqid_cli.params.files import check_output
from seqid_cli.params.inspection_schema import (
    INSPECTION_SCHEMA,
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectedMoves,
    InspectionFile,
    InspectionFinding,
)
from seqid_cli.params.io import write_json_atomic
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.inspect.report import Finding, InspectReport, LogReport

EXAMPLES = (
    "seqid inspect sample_logs/six_joint/friction -r sample_logs/six_joint/robot.toml",
    "seqid inspect sample_logs/two_joint/imu --json",
)
EXIT_UNREADABLE = 2

OptionalRobot = Annotated[
    Path | None,
    typer.Option("-r", "--robot", metavar="FILE", help="Robot file; guessed when left out."),
]
StrictErrors = Annotated[
    bool, typer.Option("--strict", help="Exit with 1 when an error is found in a log.")
]


def run(
    context: typer.Context,
    logs: Logs,
    robot: OptionalRobot = None,
    output: Output = None,
    time: Clock = "header",
    strict: StrictErrors = False,
) -> int:
    """Look through logs: channels, rates, clocks, units, joints that move, and what is wrong.

    With a robot file, torque and IMUs are compared with its geometry as well. The exit code is 2
    when a log cannot be read, 3 when one was read in part.
    """
    screen = screen_of(context)
    files = expand(logs)
    if output is not None:
        check_output(output, [*files, *([robot] if robot else [])])
    loaded = load_robot(robot) if robot is not None else None

    from seqid_cli.inspect.inspection import inspect_logs

    progress = ProgressLine(len(files), sys.stderr, enabled=not screen.quiet)
    try:
        report = inspect_logs(files, loaded, time_source=time, progress=progress.show)
    finally:
        progress.clear()
    document = _document(report, loaded.name if loaded else "")
    if output is not None:
        write_json_atomic(output, document, inputs=files)
    screen.document(document)
    show_inspection(screen, document)
    if output is not None:
        screen.note(f"written: {output}")
    return _exit_code(screen, report, strict=strict)


def _exit_code(screen: Screen, report: InspectReport, *, strict: bool) -> int:
    unreadable = [f for f in report.findings if f.code == "unreadable"]
    if unreadable:
        first = unreadable[0]
        said = f"seqid {screen.command}: error: {first.log}: {first.message}\n"
        sys.stderr.write(visible(f"{said}  hint: {first.remedy}\n"))
        return EXIT_UNREADABLE
    if strict and any(finding.severity == "error" for finding in report.findings):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(log.partial for log in report.logs) else EXIT_DONE


def _document(report: InspectReport, robot: str) -> InspectionFile:
    return InspectionFile(
        schema=INSPECTION_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot,
        verdict=report.verdict,
        logs=[_log(log) for log in report.logs],
        findings=[_finding(finding) for finding in report.findings],
        advice=list(report.advice),
    )


def _finding(finding: Finding) -> InspectionFinding:
    return InspectionFinding(**dataclasses.asdict(finding))


def _log(log: LogReport) -> InspectedLog:
    return InspectedLog(
        path=log.path,
        sha256=log.sha256,
        format=log.format,
        verdict=log.verdict,
        samples=log.samples,
        seconds=log.seconds,
        rate_hz=log.rate_hz,
        jitter=log.jitter,
        gaps=[list(gap) for gap in log.gaps],
        non_monotonic=log.non_monotonic,
        duplicates=log.duplicates,
        log_minus_header_s=log.log_minus_header_s,
        channels=list(log.channels),
        missing=dict(log.missing),
        joints=[
            InspectedJoint(
                **{
                    **dataclasses.asdict(joint),
                    "temperature": list(joint.temperature) if joint.temperature else None,
                }
            )
            for joint in log.joints
        ],
        imus=[InspectedImu(**dataclasses.asdict(imu)) for imu in log.imus],
        moves=[InspectedMoves(**dataclasses.asdict(moves)) for moves in log.moves],
        moving_together=list(log.moving_together),
        serves=list(log.serves),
        partial=log.partial,
    )
