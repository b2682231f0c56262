"""`seqid inspect`: what is in some logs and what is wrong with them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED, called
from seqid_cli.commands.options import SIX, Output, command, option
from seqid_cli.commands.screen.layout import visible
from seqid_cli.commands.screen.show_inspection import show_inspection

EXIT_UNREADABLE = 2


@command(
    "logs robot plan output time_source strict",
    f"seqid inspect {SIX}/friction -r {SIX}/robot.toml",
    "seqid inspect sample_logs/two_joint/imu --json",
)
def inspect(
    context: typer.Context,
    robot: Annotated[
        Path | None, option("-r --robot FILE", "Robot file; guessed when left out.")
    ] = None,
    plan: Annotated[
        Path | None, option("--plan FILE", "A plan: say which of its moves these logs hold.")
    ] = None,
    output: Output = None,
    strict: Annotated[
        bool, option("--strict", "Exit with 1 on warnings and unrecorded moves as well.")
    ] = False,
) -> int:
    """Look through logs: channels, rates, clocks, units, joints that move, and what is wrong.

    With a robot file, torque and IMUs are compared with its geometry as well. The exit code is 1
    when an error is found, 2 when a log cannot be read, 3 when one was read in part.
    """
    told, report = called(context, "inspect.inspect")
    show_inspection(told.screen, report)
    if output is not None:
        told.screen.note(f"written: {output}")
    for finding in report.findings:
        if finding.code == "unreadable":
            said = f"seqid inspect: error: {finding.log}: {finding.message}\n"
            sys.stderr.write(visible(f"{said}  hint: {finding.remedy}\n"))
            return EXIT_UNREADABLE
    grave = ("error", "warning") if strict else ("error",)
    lacking = strict and any(part.status != "recorded" for part in report.planned)
    if lacking or any(finding.severity in grave for finding in report.findings):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(log.partial for log in report.logs) else EXIT_DONE
