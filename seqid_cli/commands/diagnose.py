"""`seqid diagnose`: what a model lacks, with the evidence."""

from typing import Annotated

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import exit_code, listening, tell_output, tell_remedies
from seqid_cli.commands.screen.show import show_motion
from seqid_cli.commands.screen.show_diagnosis import show_diagnosis
from seqid_cli.errors import UsageError

Explain = Annotated[
    str | None,
    opt.option(
        "--explain JOINT",
        "Tell of one joint what was tried there, what was taken and what was not, and why.",
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
        from seqid_cli.robot.file import load_robot

        names = load_robot(robot).joint_names
        if explain not in names:
            message = f"--explain names no joint of this robot: {explain!r}"
            hint = f"Its joints are {', '.join(names)}."
            raise UsageError(message, where=str(robot), hint=hint)
    with listening(context) as told:
        from seqid_cli import discover

        options = told.options(discover.DiagnoseOptions)
        file = discover.diagnose(logs, robot, parameters, options, output=output, on_progress=told)
    screen = told.screen
    screen.document(file)
    show_diagnosis(screen, file, explain)
    show_motion(screen, file.motion, file.robot)
    tell_output(screen, output, robot)
    if file.verdict != "nothing_missing":
        smooth = "" if file.findings else " --with-unexplained"
        given = " ".join(f"-p {path}" for path in parameters) + smooth
        screen.note(
            f"next: seqid refine LOG... --holdout LOG... -r {robot} {given} -o refined.json"
        )
    if file.verdicts:
        tell_remedies(screen, told.findings)
    missing = file.verdict != "nothing_missing" or bool(file.verdicts)
    return exit_code(untrusted=strict and missing, partial=told.partial)
