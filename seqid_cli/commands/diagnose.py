"""`seqid diagnose`: what a model lacks, with the evidence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import exit_code, listening, tell_output, tell_remedies
from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show import show_motion
from seqid_cli.commands.screen.show_diagnosis import show_diagnosis
from seqid_cli.errors import UsageError
from seqid_cli.params.results.diagnosis import DiagnosisFile

Explain = Annotated[
    str | None,
    typer.Option(
        "--explain",
        metavar="JOINT",
        help="Tell of one joint what was tried there, what was taken and what was not, and why.",
    ),
]
EXAMPLES = (
    "seqid diagnose sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json -o diagnosis.json",
    "seqid diagnose sample_logs/six_joint/changed -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --strict --json",
)


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    output: opt.Output = None,
    source: opt.MotionSource = "auto",
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    strict: opt.Strict = False,
    explain: Explain = None,
) -> int:
    """Find out which physical effects a model lacks; any logs will do, nothing is changed.

    With --strict the exit code is 1 unless nothing is missing.
    """
    if explain is not None:
        _known(explain, robot)
    with listening(context) as told:
        from seqid_cli import discover

        options = told.options(discover.DiagnoseOptions)
        file = discover.diagnose(logs, robot, parameters, options, output=output, on_progress=told)
    screen = told.screen
    screen.document(file)
    show_diagnosis(screen, file, explain)
    show_motion(screen, file.motion, file.robot)
    tell_output(screen, output, robot)
    _tell_next(screen, file, robot, parameters)
    if file.verdicts:
        tell_remedies(screen, told.findings)
    missing = file.verdict != "nothing_missing" or bool(file.verdicts)
    return exit_code(untrusted=strict and missing, partial=told.partial)


def _known(joint: str, robot: Path) -> None:
    from seqid_cli.robot.file import load_robot

    names = load_robot(robot).joint_names
    if joint not in names:
        raise UsageError(
            f"--explain names no joint of this robot: {joint!r}",
            where=str(robot),
            hint=f"Its joints are {', '.join(names)}.",
        )


def _tell_next(screen: Screen, file: DiagnosisFile, robot: Path, parameters: list[Path]) -> None:
    if file.verdict == "nothing_missing":
        return
    smooth = "" if file.findings else " --with-unexplained"
    given = " ".join(f"-p {path}" for path in parameters)
    screen.note(
        f"next: seqid refine LOG... --holdout LOG... -r {robot} {given}{smooth} -o refined.json"
    )
