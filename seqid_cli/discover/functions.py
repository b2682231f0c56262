"""Diagnosis and refinement as functions: logs, robot and model in, the document out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from msgspec import structs

from seqid_cli.discover.options import DiagnoseOptions, DiscoverOptions, RefineOptions
from seqid_cli.discover.refinement.log_sets import (
    check_unseen,
    find_earlier,
    held_out_logs,
)
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.identify.inputs import Inputs, Models, imu_stage_for, prepare
from seqid_cli.identify.options import Keywords, documented, tells_steps
from seqid_cli.logs.given import Logs, PathLike, optional
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import (
    present,
    refined,
    robot_id,
    stages_before,
    used_settings,
)
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot


@documented(Keywords)
@tells_steps
def diagnose(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: DiagnoseOptions = DiagnoseOptions(),
    *,
    settings: DiscoverSettings = DiscoverSettings(),
    **keywords: Unpack[Keywords],
) -> DiagnosisFile:
    """Find out which physical effects a model lacks; nothing is changed.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Any logs with torque or current; of long ones excerpts are taken (see
        `excerpts`).
    parameters : path or ParameterFile, or a sequence of them
        With the stages friction and inertia; effects that are in it are not missing.
    """
    # Whatever is wrong with the files is said before anything heavy is imported.
    needs = ("friction", "inertia", *imu_stage_for(options.source))
    inputs = prepare(logs, robot, parameters, options, needs=needs, **keywords)
    from seqid_cli.discover.diagnosis import diagnose as find_what_is_missing
    from seqid_cli.discover.excerpts import one_each, take_excerpts
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.prediction.model_checks import model_verdicts
    from seqid_cli.identify.regression.equations import motion_uses

    arm = inputs.robot
    stages = inputs.stages
    discover_options = _discover_options(inputs, options, settings)
    motion_options = discover_options.motion
    log_set = LogSet.of(inputs)
    excerpts = take_excerpts(
        log_set, arm, stages, options=motion_options, settings=settings.events
    )
    diagnosis = find_what_is_missing(
        excerpts.recordings, arm, stages, options=discover_options
    )

    notes = [*excerpts.notes(arm), *diagnosis.notes]
    file = structs.replace(
        diagnosis,
        created=log_set.created(inputs.documents),
        robot=robot_id(arm),
        inputs=log_set.inputs(),
        parameters=inputs.ids(),
        stages=list(present(stages)),
        motion=motion_uses(one_each(excerpts), arm, stages.imu, options=motion_options),
        verdicts=[
            *model_verdicts(stages, arm, settings.judging),
            *log_set.verdicts(),
        ],
        settings=used_settings(settings),
        notes=[*notes, *log_set.notes(notes)],
    )
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file


@documented(Keywords)
@tells_steps
def refine(
    logs: Logs,
    holdout: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: RefineOptions = RefineOptions(),
    *,
    settings: DiscoverSettings = DiscoverSettings(),
    **keywords: Unpack[Keywords],
) -> ParameterFile:
    """Add the effects that a model lacks while left-out blocks are predicted better.

    The result has `stages.effects` and `closed_loop`.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Logs to fit; effects are chosen on left-out blocks of them.
    holdout : path, table, recording, or a sequence of them
        Logs that are opened after the last decision: they choose nothing, and what they
        do not confirm is taken out.
    parameters : path or ParameterFile, or a sequence of them
        As in `diagnose`; logs of earlier stages are read again where they are still
        there.
    """
    held_out = held_out_logs(logs, holdout)
    held_out_files = [log for log in held_out if isinstance(log, Path)]
    output = optional(keywords.get("output"))
    if output is not None:
        check_output(output, held_out_files)

    needs = ("friction", "inertia", *imu_stage_for(options.source))
    inputs = prepare(
        logs, robot, parameters, options, needs=needs, stored=False, **keywords
    )
    discover_options = replace(
        _discover_options(inputs, options, settings),
        max_effects=options.rounds,
        with_unexplained=options.with_unexplained,
    )
    file = _refined(
        inputs,
        held_out,
        discover_options,
        keep_unconfirmed=options.keep_unconfirmed,
    )
    if output is not None:
        write_json_atomic(output, file, inputs=[*inputs.sources, *held_out_files])
    return file


def _discover_options(
    inputs: Inputs, options: DiagnoseOptions, settings: DiscoverSettings
) -> DiscoverOptions:
    """Return what a user asked for, with the cut-off that the model was made with."""
    from seqid_cli.identify.common_cutoff import inherited
    from seqid_cli.identify.options import InertiaOptions

    filtering = inherited(inputs.stages, options.cutoff_hz)
    source = "needed" if options.source == "auto" else options.source
    motion = InertiaOptions(motion=filtering, source=source)
    return DiscoverOptions(motion=motion, settings=settings)


def _refined(
    inputs: Inputs,
    held_out: Sequence[Path | Recording],
    options: DiscoverOptions,
    *,
    keep_unconfirmed: bool,
) -> ParameterFile:
    """Return the refined parameter file."""
    from seqid_cli.discover.excerpts import by_digest, one_each, take_excerpts
    from seqid_cli.discover.refinement.confirm import confirm
    from seqid_cli.discover.refinement.earlier_logs import read_earlier
    from seqid_cli.discover.refinement.held_out import WholeLogs
    from seqid_cli.discover.refinement.rounds import refine as decide
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.prediction.model_checks import model_verdicts
    from seqid_cli.identify.regression.equations import motion_uses

    previous = inputs.previous
    assert previous is not None
    robot = inputs.robot
    stages = inputs.stages

    # The logs that are fitted, and those that the model was identified from.
    training = LogSet.of(inputs)
    fitted = take_excerpts(
        training, robot, stages, options=options.motion, places=False
    )
    fitted_paths = {
        sha256: pieces[0].path
        for sha256, pieces in by_digest(fitted.recordings).items()
    }
    held_out_files = [log for log in held_out if isinstance(log, Path)]
    earlier = find_earlier(
        previous.inputs,
        folders=[path.parent for path in inputs.parameters],
        at_hand=fitted_paths,
        held_out=held_out_files,
    )
    earlier_logs = read_earlier(inputs, earlier, fitted, options.motion)
    n_earlier = sum(map(len, earlier_logs.by_stage.values()))
    training.tell(
        "detail",
        text=f"{len(fitted.recordings)} logs to fit, {n_earlier} of earlier stages",
    )
    decided = decide(
        fitted.recordings,
        robot,
        previous,
        earlier=earlier_logs.by_stage,
        incomplete=earlier_logs.incomplete,
        options=options,
    )

    # Nothing is chosen any more: now the held-out logs are opened. They take out what
    # they do not confirm, by a rule that is fixed.
    held_out_set = LogSet.of(replace(inputs, logs=tuple(held_out), missing=()))
    unseen = take_excerpts(
        held_out_set, robot, stages, options=options.motion, places=False
    )
    unseen_paths = {
        sha256: pieces[0].path
        for sha256, pieces in by_digest(unseen.recordings).items()
    }
    check_unseen(unseen_paths.items(), {**earlier.paths, **fitted_paths})
    whole_logs = WholeLogs(tuple(held_out_files), robot, inputs.reading)
    confirmed = confirm(
        decided,
        unseen.recordings,
        whole_logs if unseen.surveys else None,
        keep_unconfirmed=keep_unconfirmed,
    )

    verdicts = [
        *model_verdicts(stages, robot, options.settings.judging),
        *training.verdicts(),
        *held_out_set.verdicts(),
    ]
    one_of_each_log = [*one_each(fitted), *one_each(unseen)]
    loop = structs.replace(
        confirmed.loop,
        verdict="poor" if verdicts else confirmed.loop.verdict,
        held_out=held_out_set.inputs(),
        incoming=stages_before(previous, confirmed.stages),
        motion=motion_uses(one_of_each_log, robot, stages.imu, options=options.motion),
        verdicts=verdicts,
        settings=used_settings(options.settings),
        notes=[
            *(f"fitted: {note}" for note in fitted.notes(robot)),
            *(f"held out: {note}" for note in unseen.notes(robot)),
            *earlier_logs.notes,
            *training.notes(),
            *held_out_set.notes(),
            *confirmed.loop.notes,
        ],
    )
    return refined(
        previous,
        robot_id(robot),
        training.inputs("effects"),
        confirmed.stages,
        loop,
        created=created_from(
            [previous], [*training.times_s(), *held_out_set.times_s()]
        ),
    )
