"""`seqid inertia`: the last stage."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

from seqid_cli.commands.job import prepare
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
    imu_stage_for,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.show_motion import announced
from seqid_cli.commands.stages import run_stage
from seqid_cli.params.schema import Stages
from seqid_cli.scale.options import Workers

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording

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
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters,
        output=output,
        time_source=time,
        workers=Workers(jobs, engine, scheduler, skip_failed),
        needs=("friction", "gravity", *imu_stage_for(motion)),
    )

    from seqid_cli.identify.consistency import made_consistent
    from seqid_cli.identify.inertia_stage import identify_inertia
    from seqid_cli.identify.one_cutoff import identification_options
    from seqid_cli.identify.options import InertiaOptions

    filtering = identification_options(
        job.files,
        job.robot,
        cutoff_hz=cutoff,
        imu=job.stages.imu,
        source=motion,
        time_source=job.time_source,
    )
    options = InertiaOptions(motion=filtering, source=motion)

    def identify(recordings: Iterable[Recording]) -> Stages:
        logs = announced(recordings, job.screen, job.stages.imu, motion)
        stage = identify_inertia(logs, job.robot, job.stages, options=options, compare=True)
        if consistent:
            stage = made_consistent(stage, job.stages, job.robot)
        return Stages(inertia=stage)

    return run_stage(job, identify, strict=strict, following=_FOLLOWING)
