"""`seqid imu-calib`: how the IMUs sit on their links."""

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
    OptionalParameters,
    Output,
    RobotPath,
    Scheduler,
    SkipFailed,
    Strict,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.stages import run_stage
from seqid_cli.errors import ConfigError
from seqid_cli.params.schema import Stages
from seqid_cli.scale.options import Workers

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording

EXAMPLES = (
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml"
    " -p gravity.json -o imu.json",
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml --json",
)
_FOLLOWING = "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    parameters: OptionalParameters = None,
    output: Output = None,
    cutoff: Cutoff = None,
    time: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    strict: Strict = False,
) -> int:
    """Find how accelerometers and IMUs are mounted on the links, and what they are like.

    The logs hold rotations of the first joint with the other joints locked in several
    configurations. Mounting, place, biases, scales, axes and clock offset are found together.
    """
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters or (),
        output=output,
        time_source=time,
        workers=Workers(jobs, engine, scheduler, skip_failed),
    )
    if not job.robot.imus:
        hint = "Add an [[imu]] table with its accelerometers."
        raise ConfigError("the robot file names no IMU", where=str(robot), hint=hint)

    from seqid_cli.identify.imu import calibrate_imus
    from seqid_cli.motion.imu.array import layout_report
    from seqid_cli.motion.options import MotionOptions

    for imu in job.robot.imus:
        for text in layout_report(imu).statements:
            job.screen.note(f"{imu.name}: {text}")
    options = MotionOptions(cutoff_hz=cutoff)
    earlier = job.previous.stages if job.previous else None

    def identify(recordings: Iterable[Recording]) -> Stages:
        return Stages(imu=calibrate_imus(recordings, job.robot, earlier, options=options))

    return run_stage(job, identify, strict=strict, following=_FOLLOWING, imus=True)
