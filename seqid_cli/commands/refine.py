"""`seqid refine`: the loop closed, from what a model lacks to a model that has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.earlier_logs import read_earlier
from seqid_cli.commands.evidence import evidence_entry, rival_entries
from seqid_cli.commands.job import Account, Job, exit_code, prepare
from seqid_cli.commands.log_sets import check_unseen, find_earlier, held_out_logs
from seqid_cli.commands.options import (
    Clock,
    Cutoff,
    Logs,
    MotionSource,
    Output,
    Parameters,
    RobotPath,
    Strict,
    imu_stage_for,
    source_for_effects,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.show_motion import announced, show_motion
from seqid_cli.commands.show_refinement import show_refinement
from seqid_cli.commands.stages import tell_output, tell_remedies
from seqid_cli.params.document import refined, robot_id
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import (
    ClosedLoop,
    InputLog,
    JointRmse,
    MotionUse,
    ParameterFile,
    RefinementRound,
    Verdict,
)

if TYPE_CHECKING:
    from seqid_cli.discover import results
    from seqid_cli.discover.gather import Gathered
    from seqid_cli.discover.options import DiscoverOptions
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot

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
    typer.Option(
        "--holdout",
        metavar="LOG",
        help="Log, folder or glob that is opened after the last decision, and only reported on;"
        " repeat it for several.",
    ),
]
Rounds = Annotated[
    int, typer.Option("--rounds", metavar="N", min=1, max=100, help="At most this many effects.")
]
WithUnexplained = Annotated[
    bool,
    typer.Option("--with-unexplained", help="Add a smooth term where no known effect explains."),
]


def run(
    context: typer.Context,
    logs: Logs,
    holdout: Holdout,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    rounds: Rounds = 4,
    with_unexplained: WithUnexplained = False,
    motion: MotionSource = "auto",
    cutoff: Cutoff = None,
    time: Clock = "header",
    strict: Strict = False,
) -> int:
    """Add the effects that a model lacks, as long as left-out blocks are predicted better.

    The held-out logs decide nothing: they are opened last, and confirm each effect or do not.
    With --strict the exit code is 1 if nothing helped, or if they do not confirm all of it.
    """
    held_out = held_out_logs(logs, holdout)
    if output is not None:
        check_output(output, held_out)
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters,
        output=output,
        time_source=time,
        needs=("friction", "inertia", *imu_stage_for(motion)),
    )
    assert job.previous is not None

    from seqid_cli.discover.options import DiscoverOptions
    from seqid_cli.identify.one_cutoff import inherited
    from seqid_cli.identify.options import InertiaOptions

    options = DiscoverOptions(
        InertiaOptions(inherited(job.previous.stages, cutoff), source=source_for_effects(motion)),
        max_effects=rounds,
        with_unexplained=with_unexplained,
    )
    file, accounts = _refine(job, job.previous, held_out, options)
    assert file.closed_loop is not None
    if job.output is not None:
        inputs = [*job.files, *held_out, *job.parameters]
        write_json_atomic(job.output, file, inputs=inputs)
    job.screen.document(file)
    show_refinement(job.screen, file.closed_loop, file.stages.effects or [])
    show_motion(job.screen, file.closed_loop.motion)
    tell_output(job, _FOLLOWING)
    loop = file.closed_loop
    if loop.verdicts:
        tell_remedies(job.screen, [found for account in accounts for found in account.findings])
    partial = [text for account in accounts for text in account.partial]
    untrusted = strict and (loop.verdict == "poor" or not loop.rounds)
    return exit_code(untrusted=untrusted, partial=partial)


def _refine(
    job: Job, previous: ParameterFile, held_out: Sequence[Path], options: DiscoverOptions
) -> tuple[ParameterFile, list[Account]]:
    from seqid_cli.discover.confirm import confirm
    from seqid_cli.discover.gather import one_each
    from seqid_cli.discover.heldout import WholeLogs
    from seqid_cli.discover.refinement import refine
    from seqid_cli.identify.judge import physics_verdicts
    from seqid_cli.identify.motion_use import motion_uses

    training = Account(job)
    fitted = _gathered(training, job, options)
    folders = [path.parent for path in job.parameters]
    at_hand = _paths(fitted.recordings)
    found = find_earlier(previous.inputs, folders, at_hand=at_hand, held_out=held_out)
    earlier = read_earlier(job, found, fitted, options.motion)
    count = sum(map(len, earlier.by_stage.values()))
    job.screen.detail(f"{len(fitted.recordings)} logs to fit, {count} of earlier stages")
    decided = refine(
        fitted.recordings, job.robot, previous, earlier=earlier.by_stage, options=options
    )

    # Nothing is decided any more: now the held-out logs are opened.
    kept_out = Account(replace(job, files=tuple(held_out)))
    unseen = _gathered(kept_out, replace(job, files=tuple(held_out)), options)
    check_unseen(_paths(unseen.recordings), {**found.paths, **at_hand})
    whole = WholeLogs(tuple(held_out), job.robot, job.time_source) if unseen.looks else None
    loop = confirm(decided, unseen.recordings, whole)
    given = [*one_each(fitted), *one_each(unseen)]
    uses = motion_uses(given, job.robot, job.stages.imu, options=options.motion)
    notes = [
        *(f"fitted: {note}" for note in fitted.notes(job.robot)),
        *(f"held out: {note}" for note in unseen.notes(job.robot)),
        *found.notes,
        *earlier.notes,
        *training.notes(),
        *kept_out.notes(),
    ]
    verdicts = [
        *physics_verdicts(job.stages, job.robot),
        *training.verdicts(),
        *kept_out.verdicts(),
    ]
    file = refined(
        previous,
        robot_id(job.robot),
        training.inputs("effects"),
        decided.stages,
        closed_loop(loop, job.robot, kept_out.inputs(), notes, uses, verdicts),
    )
    return file, [training, kept_out, *earlier.accounts]


def _gathered(account: Account, job: Job, options: DiscoverOptions) -> Gathered:
    from seqid_cli.discover.gather import gather

    return gather(
        announced(account, job.screen, job.stages.imu, options.motion.source),
        job.robot,
        job.stages,
        options=options.motion,
        paths=job.files,
        time_source=job.time_source,
        aside=False,
    )


def _paths(recordings: Sequence[Recording]) -> dict[str, Path]:
    """Where each log is, by its SHA-256."""
    from seqid_cli.discover.gather import by_digest

    return {sha256: some[0].path for sha256, some in by_digest(recordings).items()}


def closed_loop(
    loop: results.ClosedLoop,
    robot: Robot,
    held_out: list[InputLog],
    notes: Sequence[str],
    motion: list[MotionUse],
    verdicts: list[Verdict],
) -> ClosedLoop:
    """What a refined file says of its refinement."""
    return ClosedLoop(
        verdict="good" if loop.confirmed and not verdicts else "poor",
        rounds=[_round(tried, robot) for tried in loop.rounds if tried.accepted],
        refused=[_round(tried, robot) for tried in loop.rounds if not tried.accepted],
        before=_rmse(loop.before),
        after=_rmse(loop.after),
        noise_floor=dict(loop.noise_floor),
        noise_floor_interval={name: list(x) for name, x in loop.noise_floor_interval.items()},
        gain_interval={name: list(limits) for name, limits in loop.gain_interval.items()},
        evaluated_on=list(loop.evaluated_on),
        held_out=held_out,
        motion=motion,
        verdicts=verdicts,
        notes=[*notes, *loop.notes],
    )


def _round(tried: results.Round, robot: Robot) -> RefinementRound:
    return RefinementRound(
        effect=tried.effect,
        joint=tried.joint,
        accepted=tried.accepted,
        training_gain=tried.training_gain,
        training_interval=_limits(tried.training_interval),
        held_out_gain=tried.held_out_gain,
        interval=_limits(tried.interval),
        confirmed=tried.confirmed,
        reason=tried.reason,
        evidence=evidence_entry(tried.evidence, robot),
        rivals=rival_entries(tried.rivals),
    )


def _limits(interval: tuple[float, float] | None) -> list[float]:
    """An interval as documents have it: empty where it is not known."""
    return [] if interval is None or not all(map(isfinite, interval)) else list(interval)


def _rmse(errors: Mapping[str, results.LoopError]) -> dict[str, JointRmse]:
    return {
        name: JointRmse(
            rmse=error.rmse,
            rmse_inside=_known(error.rmse_inside),
            rmse_outside=_known(error.rmse_outside),
            share_outside=error.share_outside,
        )
        for name, error in errors.items()
    }


def _known(value: float) -> float | None:
    return value if isfinite(value) else None
