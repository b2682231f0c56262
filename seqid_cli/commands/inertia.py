"""`seqid inertia`: the last stage."""

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage, workers

EXAMPLES = (
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p imu.json -o inertia.json",
    "seqid inertia sample_logs/six_joint/inertia -r sample_logs/six_joint/robot.toml"
    " -p gravity.json --motion encoder --strict",
)
_FOLLOWING = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"


def run(
    context: typer.Context,
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    output: opt.Output = None,
    source: opt.MotionSource = "auto",
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    jobs: opt.Jobs = None,
    engine: opt.Engine = "local",
    scheduler: opt.Scheduler = None,
    skip_failed: opt.SkipFailed = False,
    consistent: opt.Consistent = False,
    strict: opt.Strict = False,
) -> int:
    """Identify the inertia parameters, given friction and gravity.

    The logs hold moves of two joints (or more) at a time.
    """
    with listening(context) as told, workers(logs, jobs, engine, scheduler) as executor:
        from seqid_cli import identify

        options = told.options(identify.RigidOptions)
        file = identify.inertia(
            logs, robot, parameters, options, output=output, executor=executor, on_progress=told
        )
    return show_stage(told, file, ["inertia"], _FOLLOWING)
