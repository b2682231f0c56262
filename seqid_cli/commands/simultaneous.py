"""`seqid simultaneous`: the classical way, for comparison."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import prepare
from seqid_cli.commands.options import (
    Clock,
    Consistent,
    Cutoff,
    Logs,
    MotionSource,
    OptionalParameters,
    Output,
    RobotPath,
    Strict,
    imu_stage_for,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.show_motion import announced
from seqid_cli.commands.stages import run_stage
from seqid_cli.params.schema import Stages

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording

Offset = Annotated[
    bool,
    typer.Option("--offset", help="Give each joint's friction a constant torque besides."),
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
    logs: Logs,
    robot: RobotPath,
    parameters: OptionalParameters = None,
    output: Output = None,
    offset: Offset = False,
    motion: MotionSource = "auto",
    cutoff: Cutoff = None,
    time: Clock = "header",
    consistent: Consistent = False,
    strict: Strict = False,
) -> int:
    """Identify all parameters at once, with Coulomb and viscous friction (Eq. 5-6).

    Any logs will do. For comparison, and for data without moves of single joints. With the file of
    seqid imu-calib (-p) accelerometers are used as well.
    """
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters or (),
        output=output,
        time_source=time,
        needs=imu_stage_for(motion),
    )

    from seqid_cli.identify.consistency import made_consistent
    from seqid_cli.identify.one_cutoff import identification_options
    from seqid_cli.identify.one_step import identify_simultaneous

    options = identification_options(
        job.files,
        job.robot,
        cutoff_hz=cutoff,
        imu=job.stages.imu,
        source=motion,
        time_source=job.time_source,
    )

    def identify(recordings: Iterable[Recording]) -> Stages:
        imu = job.stages.imu
        friction, inertia = identify_simultaneous(
            announced(recordings, job.screen, imu, motion),
            job.robot,
            options=options,
            imu=imu,
            source=motion,
            offset=offset,
        )
        if consistent:
            inertia = made_consistent(inertia, Stages(), job.robot)
        return Stages(friction=friction, inertia=inertia)

    return run_stage(job, identify, strict=strict, following=_FOLLOWING)
