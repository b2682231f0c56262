"""`seqid imu-calib`: how the IMUs sit on their links."""

from typing import Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage

EXAMPLES = (
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml"
    " -p gravity.json -o imu.json",
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml --json",
)
_FOLLOWING = "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"


@opt.takes(
    "logs robot parameters output cutoff_hz time_source jobs engine scheduler skip_failed strict"
)
def run(
    context: typer.Context,
    parameters: opt.OptionalParameters = None,
    **shared: Any,
) -> int:
    """Find how accelerometers and IMUs are mounted on the links, and what they are like.

    The logs hold rotations of the first joint with the other joints locked in several
    configurations. Mounting, place, biases, scales, axes and clock offset are found together.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.imu_calib, identify.LogOptions)
    return show_stage(told, file, ["imu"], _FOLLOWING)
