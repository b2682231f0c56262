"""`seqid inspect`: what is in some logs and what is wrong with them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED, listening
from seqid_cli.commands.options import Clock, Logs, Output, option
from seqid_cli.commands.screen.layout import visible
from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show_inspection import show_inspection
from seqid_cli.params.results.inspection import InspectionFile

EXAMPLES = (
    "seqid inspect sample_logs/six_joint/friction -r sample_logs/six_joint/robot.toml",
    "seqid inspect sample_logs/two_joint/imu --json",
)
EXIT_UNREADABLE = 2

OptionalRobot = Annotated[
    Path | None, option("-r --robot FILE", "Robot file; guessed when left out.")
]
Plan = Annotated[
    Path | None, option("--plan FILE", "A plan: say which of its moves these logs hold.")
]
StrictErrors = Annotated[
    bool, option("--strict", "Exit with 1 on warnings and unrecorded moves as well.")
]


def run(
    context: typer.Context,
    logs: Logs,
    robot: OptionalRobot = None,
    plan: Plan = None,
    output: Output = None,
    time_source: Clock = "header",
    strict: StrictErrors = False,
) -> int:
    """Look through logs: channels, rates, clocks, units, joints that move, and what is wrong.

    With a robot file, torque and IMUs are compared with its geometry as well. The exit code is 1
    when an error is found, 2 when a log cannot be read, 3 when one was read in part.
    """
    with listening(context) as told:
        from seqid_cli.inspect import inspect

        report = inspect(
            logs, robot, time_source=time_source, plan=plan, output=output, on_progress=told
        )
    screen = told.screen
    screen.document(report)
    show_inspection(screen, report)
    if output is not None:
        screen.note(f"written: {output}")
    return _exit_code(screen, report, strict=strict)


def _exit_code(screen: Screen, report: InspectionFile, *, strict: bool) -> int:
    unreadable = [f for f in report.findings if f.code == "unreadable"]
    if unreadable:
        first = unreadable[0]
        said = f"seqid {screen.command}: error: {first.log}: {first.message}\n"
        sys.stderr.write(visible(f"{said}  hint: {first.remedy}\n"))
        return EXIT_UNREADABLE
    grave = ("error", "warning") if strict else ("error",)
    lacking = strict and any(part.status != "recorded" for part in report.planned)
    if lacking or any(finding.severity in grave for finding in report.findings):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(log.partial for log in report.logs) else EXIT_DONE
