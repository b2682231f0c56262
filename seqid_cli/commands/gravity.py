"""`seqid gravity`: the second stage."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

from seqid_cli.commands.job import prepare
from seqid_cli.commands.options import (
    Clock,
    Cutoff,
    Engine,
    Jobs,
    Logs,
    Output,
    Parameters,
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
    "seqid gravity sample_logs/six_joint/gravity sample_logs/six_joint/friction"
    " -r sample_logs/six_joint/robot.toml -p friction.json -o gravity.json",
    "seqid gravity sample_logs/six_joint/gravity -r sample_logs/six_joint/robot.toml"
    " -p friction.json --strict",
)
_FOLLOWING = (
    "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"
    "  (with accelerometers: seqid imu-calib first)"
)


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    cutoff: Cutoff = None,
    time: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    strict: Strict = False,
) -> int:
    """Identify the gravity parameters, given the friction.

    The logs hold moves of one joint at a time at constant velocity, with the other joints locked in
    several configurations.
    """
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters,
        output=output,
        time_source=time,
        workers=Workers(jobs, engine, scheduler, skip_failed),
        needs=("friction",),
    )

    from seqid_cli.identify.gravity_stage import identify_gravity
    from seqid_cli.motion.options import MotionOptions

    options = MotionOptions(cutoff_hz=cutoff)

    def identify(recordings: Iterable[Recording]) -> Stages:
        return Stages(gravity=identify_gravity(recordings, job.robot, job.stages, options=options))

    return run_stage(job, identify, strict=strict, following=_FOLLOWING)
