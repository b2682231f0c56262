"""`seqid friction`: the first stage."""

from typing import Annotated

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage, workers

EXAMPLES = (
    "seqid friction sample_logs/six_joint/friction -r sample_logs/six_joint/robot.toml"
    " -o friction.json",
    "seqid friction 'sample_logs/six_joint/friction/*' -r sample_logs/six_joint/robot.toml"
    " --position-order 4 --velocity-order 5 --json",
)
_FOLLOWING = "seqid gravity LOG... -r {robot} -p {output} -o gravity.json"

PositionOrder = Annotated[
    int | None,
    opt.option("--position-order N", "Order in position; found when left out.", min=0, max=30),
]
VelocityOrder = Annotated[
    int | None,
    opt.option("--velocity-order N", "Order in velocity; found when left out.", min=0, max=30),
]
Beta = Annotated[
    float | None,
    opt.option(
        "--beta SHARE",
        "End the search for orders as soon as Eq. 11 holds at this threshold.",
        min=0.0,
        max=1.0,
    ),
]


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    output: opt.Output = None,
    position_order: PositionOrder = None,
    velocity_order: VelocityOrder = None,
    beta: Beta = None,
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    jobs: opt.Jobs = None,
    engine: opt.Engine = "local",
    scheduler: opt.Scheduler = None,
    skip_failed: opt.SkipFailed = False,
    strict: opt.Strict = False,
) -> int:
    """Identify joint friction over position and velocity.

    The logs hold moves of one joint at a time at constant velocity, forward and backward, at
    several speeds.
    """
    with listening(context) as told, workers(logs, jobs, engine, scheduler) as executor:
        from seqid_cli import identify

        options = told.options(identify.FrictionOptions)
        file = identify.friction(
            logs, robot, options, output=output, executor=executor, on_progress=told
        )
    return show_stage(told, file, ["friction"], _FOLLOWING)
