"""`seqid gravity`: the second stage."""

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage, workers

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
    logs: opt.Logs,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    output: opt.Output = None,
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    jobs: opt.Jobs = None,
    engine: opt.Engine = "local",
    scheduler: opt.Scheduler = None,
    skip_failed: opt.SkipFailed = False,
    strict: opt.Strict = False,
) -> int:
    """Identify the gravity parameters, given the friction.

    The logs hold moves of one joint at a time at constant velocity, with the other joints locked in
    several configurations.
    """
    with listening(context) as told, workers(logs, jobs, engine, scheduler) as executor:
        from seqid_cli import identify

        options = told.options(identify.LogOptions)
        file = identify.gravity(
            logs, robot, parameters, options, output=output, executor=executor, on_progress=told
        )
    return show_stage(told, file, ["gravity"], _FOLLOWING)
