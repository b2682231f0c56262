"""Diagnosis and refinement as functions: logs, a robot file and a model in, the document out."""

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
from seqid_cli.identify.options import Keywords, documented
from seqid_cli.logs.given import Logs, PathLike, optional
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import present, refined, robot_id, used_settings
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot


@documented(Keywords)
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
    needs = ("friction", "inertia", *imu_stage_for(options.source))
    inputs = prepare(logs, robot, parameters, options, needs=needs, **keywords)
    from seqid_cli.discover.diagnosis import diagnose as diagnosed
    from seqid_cli.discover.excerpts import one_each, take_excerpts
    from seqid_cli.identify.judging import physics_verdicts
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.regression.equations import motion_uses

    search, given = _search(inputs, options), LogSet.of(inputs)
    stages, arm = inputs.stages, inputs.robot
    held = take_excerpts(given, arm, stages, options=search.motion)
    found = diagnosed(held.recordings, arm, stages, options=search)
    said = [*held.notes(arm), *found.notes]
    file = structs.replace(
        found,
        created=given.created(inputs.documents),
        robot=robot_id(arm),
        inputs=given.inputs(),
        parameters=inputs.ids(),
        stages=list(present(stages)),
        motion=motion_uses(one_each(held), arm, stages.imu, options=search.motion),
        verdicts=[*physics_verdicts(stages, arm, settings.judging), *given.verdicts()],
        settings=used_settings(settings),
        notes=[*said, *given.notes(said)],
    )
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file


@documented(Keywords)
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
    """Add the effects that a model lacks, as long as left-out blocks are predicted better.

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
    held_out, target = held_out_logs(logs, holdout), optional(keywords.get("output"))
    files = [log for log in held_out if isinstance(log, Path)]
    if target is not None:
        check_output(target, files)
    needs = ("friction", "inertia", *imu_stage_for(options.source))
    inputs = prepare(
        logs, robot, parameters, options, needs=needs, stored=False, **keywords
    )
    search = replace(_search(inputs, options), max_effects=options.rounds)
    search = replace(search, with_unexplained=options.with_unexplained)
    file = _refined(
        inputs, held_out, search, settings, keep_unconfirmed=options.keep_unconfirmed
    )
    if target is not None:
        write_json_atomic(target, file, inputs=[*inputs.sources, *files])
    return file


def _search(inputs: Inputs, options: DiagnoseOptions) -> DiscoverOptions:
    from seqid_cli.identify.common_cutoff import inherited
    from seqid_cli.identify.options import InertiaOptions

    filtering = inherited(inputs.stages, options.cutoff_hz)
    source = "needed" if options.source == "auto" else options.source
    return DiscoverOptions(InertiaOptions(filtering, source=source))


def _refined(
    inputs: Inputs,
    held_out: Sequence[Path | Recording],
    search: DiscoverOptions,
    settings: DiscoverSettings,
    *,
    keep_unconfirmed: bool,
) -> ParameterFile:
    from seqid_cli.discover.excerpts import by_digest, one_each, take_excerpts
    from seqid_cli.discover.refinement.confirm import confirm
    from seqid_cli.discover.refinement.earlier_logs import read_earlier
    from seqid_cli.discover.refinement.held_out import WholeLogs
    from seqid_cli.discover.refinement.rounds import refine as decide
    from seqid_cli.identify.judging import physics_verdicts
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.regression.equations import motion_uses

    assert inputs.previous is not None
    robot, previous, stages = inputs.robot, inputs.previous, inputs.stages
    training, motion = LogSet.of(inputs), search.motion
    fitted = take_excerpts(training, robot, stages, options=motion, places=False)
    at_hand = {
        sha256: some[0].path for sha256, some in by_digest(fitted.recordings).items()
    }
    files = [log for log in held_out if isinstance(log, Path)]
    folders = [path.parent for path in inputs.parameters]
    found = find_earlier(previous.inputs, folders, at_hand=at_hand, held_out=files)
    earlier, unread = read_earlier(inputs, found, fitted, motion)
    count = sum(map(len, earlier.values()))
    training.tell(
        "detail",
        text=f"{len(fitted.recordings)} logs to fit, {count} of earlier stages",
    )
    decided = decide(
        fitted.recordings, robot, previous, earlier=earlier, options=search
    )

    # Nothing is chosen any more: now the held-out logs are opened. They take out what
    # they do not confirm, by a rule that is fixed.
    kept_out = LogSet.of(replace(inputs, logs=tuple(held_out), missing=()))
    unseen = take_excerpts(kept_out, robot, stages, options=motion, places=False)
    held = {
        sha256: some[0].path for sha256, some in by_digest(unseen.recordings).items()
    }
    check_unseen(held.items(), {**found.paths, **at_hand})
    whole = WholeLogs(tuple(files), robot, inputs.options.time_source)
    confirmed = confirm(
        decided,
        unseen.recordings,
        whole if unseen.surveys else None,
        keep_unconfirmed=keep_unconfirmed,
    )
    loop = confirmed.loop
    physics = physics_verdicts(stages, robot, settings.judging)
    verdicts = [*physics, *training.verdicts(), *kept_out.verdicts()]
    both = [*one_each(fitted), *one_each(unseen)]
    loop = structs.replace(
        loop,
        verdict="poor" if verdicts else loop.verdict,
        held_out=kept_out.inputs(),
        motion=motion_uses(both, robot, stages.imu, options=motion),
        verdicts=verdicts,
        settings=used_settings(settings),
        notes=[
            *(f"fitted: {note}" for note in fitted.notes(robot)),
            *(f"held out: {note}" for note in unseen.notes(robot)),
            *(*found.notes, *unread, *training.notes(), *kept_out.notes(), *loop.notes),
        ],
    )
    created = created_from([previous], [*training.times_s(), *kept_out.times_s()])
    read = training.inputs("effects")
    return refined(
        previous, robot_id(robot), read, confirmed.stages, loop, created=created
    )
