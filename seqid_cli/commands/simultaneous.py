"""`seqid simultaneous`: the classical way, for comparison."""

from typing import Annotated

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


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.OptionalParameters = None,
    output: opt.Output = None,
    offset: Offset = True,
    source: opt.MotionSource = "auto",
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    consistent: opt.Consistent = False,
    strict: opt.Strict = False,
) -> int:
    """Identify all parameters at once, with Coulomb and viscous friction (Eq. 5-6).

    Any logs will do. For comparison, and for data without moves of single joints. With the file of
    seqid imu-calib (-p) accelerometers are used as well.
    """
    with listening(context) as told:
        from seqid_cli import identify

        options = told.options(identify.SimultaneousOptions)
        file = identify.simultaneous(
            logs, robot, parameters or (), options, output=output, on_progress=told
        )
    return show_stage(told, file, ["friction", "inertia"], _FOLLOWING)
