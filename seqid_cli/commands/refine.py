"""`seqid refine`: the loop closed, from what a model lacks to a model that has it."""

from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening
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


@opt.takes(
    "logs holdout robot parameters output rounds with_unexplained"
    " source cutoff_hz time_source strict"
)
def run(
    context: typer.Context,
    holdout: Holdout,
    rounds: Rounds = 4,
    with_unexplained: WithUnexplained = False,
    **shared: Any,
) -> int:
    """Add the effects that a model lacks, as long as left-out blocks are predicted better.

    The held-out logs decide nothing: they are opened last, and confirm each effect or do not.
    With --strict the exit code is 1 if nothing helped, or if they do not confirm all of it.
    """
    with listening(context) as told:
        from seqid_cli import discover

        file = told.call(discover.refine, discover.RefineOptions)
    screen, loop = told.screen, file.closed_loop
    assert loop is not None
    screen.document(file)
    show_refinement(screen, loop, file)
    show_motion(screen, loop.motion, file.robot)
    told.tell_output(_FOLLOWING)
    return told.ended(loop.verdicts, untrusted=loop.verdict == "poor" or not loop.rounds)
