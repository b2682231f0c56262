"""`seqid payload`: what the flange carries."""

from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening
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


@opt.takes(
    "logs robot parameters output friction_change source cutoff_hz time_source skip_failed strict"
)
def run(
    context: typer.Context,
    friction_change: FrictionChange = 0.2,
    **shared: Any,
) -> int:
    """Identify the mass, centre of mass and inertia of what the flange carries.

    The logs are recorded with the tool or load, the parameter file is of the arm without it. Moves
    of all joints, some of them slow, tell most. The result is in the frame of the last joint.
    """
    with listening(context) as told:
        from seqid_cli import payload

        file = told.call(payload.payload, payload.PayloadOptions)
    screen = told.screen
    screen.document(file)
    _show(screen, file)
    told.tell_output()
    return told.ended(file.verdicts)


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
