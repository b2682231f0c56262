"""`seqid payload`: what the flange carries."""

from typing import Annotated

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, tell_output
from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show import show_poor, verdict_text
from seqid_cli.params.results import tables
from seqid_cli.params.results.payload import PayloadFile

EXAMPLES = (
    "seqid payload sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json -o payload.json",
    "seqid payload sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --friction-change 0.1 --json",
)

FrictionChange = Annotated[
    float,
    opt.option(
        "--friction-change SHARE",
        "Standard deviation by which friction may differ from the model's, as a share of it.",
        opt.only("a positive number"),
    ),
]


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    output: opt.Output = None,
    friction_change: FrictionChange = 0.2,
    source: opt.MotionSource = "auto",
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    skip_failed: opt.SkipFailed = False,
    strict: opt.Strict = False,
) -> int:
    """Identify the mass, centre of mass and inertia of what the flange carries.

    The logs are recorded with the tool or load, the parameter file is of the arm without it. Moves
    of all joints, some of them slow, tell most. The result is in the frame of the last joint.
    """
    with listening(context) as told:
        from seqid_cli import payload

        options = told.options(payload.PayloadOptions)
        file = payload.payload(logs, robot, parameters, options, output=output, on_progress=told)
    screen = told.screen
    screen.document(file)
    _show(screen, file)
    tell_output(screen, output, robot)
    return told.ended(file.verdicts, strict=strict)


def _show(screen: Screen, file: PayloadFile) -> None:
    rows = [(name, x.value, x.std_error, x.unit) for name, x in file.payload.numbers()]
    titles, frame = "payload, frame {frame} | value | std error | unit", file.payload.frame
    screen.values(tables.values(titles, "text number4 number2 text", rows, frame=frame))
    screen.values(tables.payload_joints(file))
    for where, text in file.settings.items():
        screen.result(f"{where}: {text}")
    show_poor(screen, [verdict for verdict in file.verdicts if verdict.joint], "payload")
    screen.result(f"payload: {verdict_text(file.verdicts, '')}")
    screen.remark(*file.notes)
