"""`seqid refine`: the loop closed, from what a model lacks to a model that has it."""

from typing import Annotated

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import exit_code, listening, tell_output, tell_remedies
from seqid_cli.commands.screen.show import show_motion
from seqid_cli.commands.screen.show_diagnosis import show_refinement

EXAMPLES = (
    "seqid refine sample_logs/six_joint/changed/fourier.parquet"
    " --holdout sample_logs/six_joint/changed/held_out.parquet"
    " -r sample_logs/six_joint/robot.toml -p inertia.json -o refined.json",
    "seqid refine sample_logs/six_joint/changed/fourier.parquet"
    " sample_logs/six_joint/changed/trapezoids.parquet"
    " --holdout sample_logs/six_joint/changed/held_out.parquet"
    " -r sample_logs/six_joint/robot.toml -p inertia.json --rounds 2 --json",
)
_FOLLOWING = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"

Holdout = Annotated[
    list[str],
    opt.option(
        "--holdout LOG",
        "Log, folder or glob that is opened after the last decision, and only reported on;"
        " repeat it for several.",
    ),
]
Rounds = Annotated[int, opt.option("--rounds N", "At most this many effects.", min=1, max=100)]
WithUnexplained = Annotated[
    bool, opt.option("--with-unexplained", "Add a smooth term where no known effect explains.")
]


def run(
    context: typer.Context,
    logs: opt.Logs,
    holdout: Holdout,
    robot: opt.RobotPath,
    parameters: opt.Parameters,
    output: opt.Output = None,
    rounds: Rounds = 4,
    with_unexplained: WithUnexplained = False,
    source: opt.MotionSource = "auto",
    cutoff_hz: opt.Cutoff = None,
    time_source: opt.Clock = "header",
    strict: opt.Strict = False,
) -> int:
    """Add the effects that a model lacks, as long as left-out blocks are predicted better.

    The held-out logs decide nothing: they are opened last, and confirm each effect or do not.
    With --strict the exit code is 1 if nothing helped, or if they do not confirm all of it.
    """
    with listening(context) as told:
        from seqid_cli import discover

        options = told.options(discover.RefineOptions)
        file = discover.refine(
            logs, holdout, robot, parameters, options, output=output, on_progress=told
        )
    screen, loop = told.screen, file.closed_loop
    assert loop is not None
    screen.document(file)
    show_refinement(screen, loop, file)
    show_motion(screen, loop.motion, file.robot)
    tell_output(screen, output, robot, _FOLLOWING)
    if loop.verdicts:
        tell_remedies(screen, told.findings)
    untrusted = strict and (loop.verdict == "poor" or not loop.rounds)
    return exit_code(untrusted=untrusted, partial=told.partial)
