"""`seqid simultaneous`: the classical way, for comparison."""

from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage

Offset = Annotated[
    bool, opt.option("--offset/--no-offset", "Give each joint a constant torque besides friction.")
]
EXAMPLES = (
    "seqid simultaneous sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -o simultaneous.json",
    "seqid simultaneous sample_logs/six_joint/friction sample_logs/six_joint/inertia"
    " -r sample_logs/six_joint/robot.toml --json",
)
_FOLLOWING = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"


@opt.takes("logs robot parameters output offset source cutoff_hz time_source consistent strict")
def run(
    context: typer.Context,
    parameters: opt.OptionalParameters = None,
    offset: Offset = True,
    **shared: Any,
) -> int:
    """Identify all parameters at once, with Coulomb and viscous friction (Eq. 5-6).

    Any logs will do. For comparison, and for data without moves of single joints. With the file of
    seqid imu-calib (-p) accelerometers are used as well.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.simultaneous, identify.SimultaneousOptions)
    return show_stage(told, file, ["friction", "inertia"], _FOLLOWING)
