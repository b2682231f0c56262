"""`seqid inertia`: the last stage."""

from __future__ import annotations

import typer

from seqid_cli.commands.job import listening, workers
from seqid_cli.commands.options import (
    Clock,
    Consistent,
    Cutoff,
    Engine,
    Jobs,
    Logs,
    MotionSource,
    Output,
    Parameters,
    RobotPath,
    Scheduler,
    SkipFailed,
    Strict,
)
from seqid_cli.commands.screen.render import screen_of
from seqid_cli.commands.stages import show_stage

EXAMPLES = (
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p imu.json -o inertia.json",
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p gravity.json --motion encoder --strict",
)
_FOLLOWING = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    motion: MotionSource = "auto",
    cutoff: Cutoff = None,
    time: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    consistent: Consistent = False,
    strict: Strict = False,
) -> int:
    """Identify the inertia parameters, given friction and gravity.

    The logs hold moves of two joints (or more) at a time.
    """
    with listening(screen_of(context)) as told, workers(logs, jobs, engine, scheduler) as executor:
        from seqid_cli import identify

        options = identify.RigidOptions(
            cutoff_hz=cutoff,
            time_source=time,
            skip_failed=skip_failed,
            source=motion,
            consistent=consistent,
        )
        file = identify.inertia(
            logs, robot, parameters, options, output=output, executor=executor, on_progress=told
        )
    return show_stage(
        told,
        file,
        ["inertia"],
        output=output,
        robot=robot,
        strict=strict,
        following=_FOLLOWING,
    )
