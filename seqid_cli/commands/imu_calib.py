"""`seqid imu-calib`: how the IMUs sit on their links."""

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage, workers

EXAMPLES = (
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml"
    " -p gravity.json -o imu.json",
    "seqid imu-calib sample_logs/six_joint/imu -r sample_logs/six_joint/robot.toml --json",
)
_FOLLOWING = "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.OptionalParameters = None,
    output: opt.Output = None,
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    jobs: opt.Jobs = None,
    engine: opt.Engine = "local",
    scheduler: opt.Scheduler = None,
    skip_failed: opt.SkipFailed = False,
    strict: opt.Strict = False,
) -> int:
    """Find how accelerometers and IMUs are mounted on the links, and what they are like.

    The logs hold rotations of the first joint with the other joints locked in several
    configurations. Mounting, place, biases, scales, axes and clock offset are found together.
    """
    with listening(context) as told, workers(logs, jobs, engine, scheduler) as executor:
        from seqid_cli import identify

        options = told.options(identify.LogOptions)
        file = identify.imu_calib(
            logs,
            robot,
            parameters or (),
            options,
            output=output,
            executor=executor,
            on_progress=told,
        )
    return show_stage(told, file, ["imu"], _FOLLOWING)
