"""`seqid inertia`: the last stage."""

from typing import Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage

EXAMPLES = (
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p imu.json -o inertia.json",
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p gravity.json --motion encoder --strict",
)
_FOLLOWING = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"


@opt.takes(
    "logs robot parameters output source"
    " cutoff_hz time_source jobs engine scheduler skip_failed consistent strict"
)
def run(context: typer.Context, **shared: Any) -> int:
    """Identify the inertia parameters, given friction and gravity.

    The logs hold moves of two joints (or more) at a time.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.inertia, identify.RigidOptions)
    return show_stage(told, file, ["inertia"], _FOLLOWING)
