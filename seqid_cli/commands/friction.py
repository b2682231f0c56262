"""`seqid friction`: the first stage."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import prepare
from seqid_cli.commands.options import (
    Clock,
    Cutoff,
    Engine,
    Jobs,
    Logs,
    Output,
    RobotPath,
    Scheduler,
    SkipFailed,
    Strict,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.stages import run_stage
from seqid_cli.params.schema import Stages
from seqid_cli.scale.options import Workers

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording

EXAMPLES = (
    "seqid friction sample_logs/six_joint/friction -r sample_logs/six_joint/robot.toml"
    " -o friction.json",
    "seqid friction 'sample_logs/six_joint/friction/*' -r sample_logs/six_joint/robot.toml"
    " --position-order 4 --velocity-order 5 --json",
)
_FOLLOWING = "seqid gravity LOG... -r {robot} -p {output} -o gravity.json"

PositionOrder = Annotated[
    int | None,
    typer.Option(metavar="N", min=0, max=30, help="Order in position; found when left out."),
]
VelocityOrder = Annotated[
    int | None,
    typer.Option(metavar="N", min=0, max=30, help="Order in velocity; found when left out."),
]
Beta = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        min=0.0,
        max=1.0,
        help="End the search for orders as soon as Eq. 11 holds at this threshold.",
    ),
]


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    output: Output = None,
    position_order: PositionOrder = None,
    velocity_order: VelocityOrder = None,
    beta: Beta = None,
    cutoff: Cutoff = None,
    time: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    strict: Strict = False,
) -> int:
    """Identify joint friction over position and velocity.

    The logs hold moves of one joint at a time at constant velocity, forward and backward, at
    several speeds.
    """
    job = prepare(
        screen_of(context),
        logs,
        robot,
        (),
        output=output,
        time_source=time,
        workers=Workers(jobs, engine, scheduler, skip_failed),
    )

    from seqid_cli.identify.friction_stage import identify_friction
    from seqid_cli.identify.options import FrictionOptions
    from seqid_cli.motion.options import MotionOptions

    options = FrictionOptions(
        motion=MotionOptions(cutoff_hz=cutoff),
        position_order=position_order,
        velocity_order=velocity_order,
        beta=beta,
    )

    def identify(recordings: Iterable[Recording]) -> Stages:
        return Stages(friction=identify_friction(recordings, job.robot, options=options))

    return run_stage(job, identify, strict=strict, following=_FOLLOWING)
