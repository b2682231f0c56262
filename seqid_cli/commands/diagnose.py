"""`seqid diagnose`: what a model lacks, with the evidence."""

from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening
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


@opt.takes("logs robot parameters output source cutoff_hz time_source strict explain")
def run(
    context: typer.Context,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    explain: Explain = None,
    **shared: Any,
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

        file = told.call(discover.diagnose, discover.DiagnoseOptions)
    screen = told.screen
    screen.document(file)
    show_diagnosis(screen, file, explain)
    show_motion(screen, file.motion, file.robot)
    told.tell_output()
    if file.verdict != "nothing_missing":
        smooth = "" if file.findings else " --with-unexplained"
        given = " ".join(f"-p {path}" for path in parameters) + smooth
        screen.note(
            f"next: seqid refine LOG... --holdout LOG... -r {robot} {given} -o refined.json"
        )
    return told.ended(file.verdicts, untrusted=file.verdict != "nothing_missing")
