"""`seqid gravity`: the second stage."""

from typing import Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage

EXAMPLES = (
    "seqid gravity sample_logs/six_joint/gravity sample_logs/six_joint/friction"
    " -r sample_logs/six_joint/robot.toml -p friction.json -o gravity.json",
    "seqid gravity sample_logs/six_joint/gravity -r sample_logs/six_joint/robot.toml"
    " -p friction.json --strict",
)
_FOLLOWING = (
    "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"
    "  (with accelerometers: seqid imu-calib first)"
)


@opt.takes(
    "logs robot parameters output cutoff_hz time_source jobs engine scheduler skip_failed strict"
)
def run(context: typer.Context, **shared: Any) -> int:
    """Identify the gravity parameters, given the friction.

    The logs hold moves of one joint at a time at constant velocity, with the other joints locked in
    several configurations.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.gravity, identify.LogOptions)
    return show_stage(told, file, ["gravity"], _FOLLOWING)
