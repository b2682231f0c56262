"""Identified models in the forms that other tools read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.export.formats import BY_TITLE, Format, format_of
from seqid_cli.export.formats import export as export_form
from seqid_cli.identify.inputs import Models, model_id, read_models, robot_of
from seqid_cli.logs.given import PathLike, listed
from seqid_cli.logs.storage.files import expand
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import head, join, present, robot_id
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.results.export import (
    EXPORT_SCHEMA,
    CollisionLimits,
    ExportedLink,
    ExportFile,
    Replay,
)
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
    from seqid_cli.export.motions import Motions, Unrefined
    from seqid_cli.robot.types import Robot


def export(
    parameters: Models,
    robot: PathLike,
    output: PathLike,
    *,
    target: str | None = None,
    replay: Sequence[PathLike] = (),
    no_replay: bool = False,
) -> ExportFile:
    """Write a model in the form that `target` names, or else the suffix of `output`.

    Forms are URDF, MJCF, ROS 2 parameters, a C header, a numpy module, and what
    controllers and simulators take. Links get inertial parameters that a body can have,
    with the identified torque, as near as can be to the URDF's. A form that cannot hold
    the whole model gets the numbers that lose least of its torque. What was written is
    run over held-out logs.

    Parameters
    ----------
    parameters : path or ParameterFile, or a sequence of them
        Whatever was identified; for a load the result of `payload`.
    robot : path
        The robot file, whose URDF is edited where it names one.
    output : path
        Where the file goes.
    target : str, optional
        The name of a form, such as "ur-friction".
    replay : sequence of paths, optional
        Logs to replay, files, folders or globs; the held-out ones of the file by
        default.
    no_replay : bool
        Whether nothing is to be replayed.

    Returns
    -------
    ExportFile
        Its `replay` says whether what was written is as good as it states.
    """
    place, goal, given = Path(robot), Path(output), listed(parameters)
    kind = format_of(goal, target)
    files = [Path(model) for model in given if not isinstance(model, ParameterFile)]
    check_output(goal, [*files, place])
    form = BY_TITLE[kind]
    if form.extent == "load":
        return _load(kind, files, place, goal)

    models = read_models(given)
    previous = join(models)
    arm = robot_of(place, models)
    if arm.urdf is not None:
        check_output(goal, [arm.urdf])
    folders = list(dict.fromkeys([*(file.parent for file in files), place.parent]))

    loop = previous.closed_loop
    errors = {name: joint.rmse for name, joint in loop.after.items()} if loop else None
    chosen, said = _replayed_logs(previous, folders, replay)
    motions = _motions(previous, arm, folders, form, chosen)
    done = export_form(
        arm,
        previous.stages,
        kind=kind,
        errors=errors,
        before=_unrefined(previous, folders, motions),
        motions=motions,
    )
    write_text_atomic(goal, done.text)
    model = done.model
    loss: dict[str, float | None] = {}
    loss_range: dict[str, list[float]] = {}
    lost_here: dict[str, float | None] = {}
    if model.loss is not None:
        loss = model.loss.stated(arm.joint_names)
        loss_range = model.loss.ranges(arm.joint_names)
        lost_here = model.loss.on_replayed(arm.joint_names)

    result, notes = None, list(model.notes)
    if no_replay:
        notes.append("nothing was checked against logs (--no-replay)")
    else:
        result, why = _replay(goal, form, previous, arm, chosen, lost_here)
        notes += [*said, *why]
    return ExportFile(
        **head(EXPORT_SCHEMA, previous.created),
        robot=robot_id(arm),
        format=kind,
        path=str(goal),
        parameters=[model_id(name, file, files) for name, file in models],
        stages=list(present(previous.stages)),
        exact=model.nearest.exact,
        largest_deviation=model.largest_deviation,
        base_parameters=list(model.deviations),
        joints={name: _link(model, k) for k, name in enumerate(arm.joint_names)},
        refitted=model.refitted,
        fitted_on=(
            [] if motions is None else [str(log.path) for log in motions.recordings]
        ),
        loss=loss,
        loss_range=loss_range,
        replay=result,
        observer_gain=float(model.observer.gain),
        collision={
            name: _collision(model, k) for k, name in enumerate(arm.joint_names)
        },
        notes=notes,
    )


def _load(kind: str, files: list[Path], place: Path, goal: Path) -> ExportFile:
    """Write what a robot carries as its controller takes it."""
    from seqid_cli.export.loads import load_setting, read_load

    arm = load_robot(place)
    source = read_load(files)
    write_text_atomic(goal, load_setting(source, arm, kind))
    return ExportFile(
        **head(EXPORT_SCHEMA, created_from((), otherwise=Path(source.path))),
        robot=robot_id(arm),
        format=kind,
        path=str(goal),
        parameters=[FileId(path=source.path, sha256=source.sha256)],
        stages=[],
        exact=True,
        largest_deviation=0.0,
        base_parameters=[],
        joints={},
        notes=["nothing was replayed: a load is not a model of the arm"],
    )


def _replayed_logs(
    previous: ParameterFile, folders: Sequence[Path], given: Sequence[PathLike]
) -> tuple[list[Path], list[str]]:
    """Return the logs to replay, and a sentence for each of the file's that is gone."""
    if given:
        return [Path(log) for log in expand([str(log) for log in given])], []
    from seqid_cli.export.motions import find_logs

    found = find_logs(held_out_logs(previous), folders)
    return list(found.files), [f"{text}: it is not replayed" for text in found.lost]


def _motions(
    previous: ParameterFile,
    arm: Robot,
    folders: Sequence[Path],
    form: Format,
    replayed: Sequence[Path],
) -> Motions | None:
    """Return the motions that a form is fitted to; None for one that holds the whole model."""
    if form.extent == "whole" or arm.locked:
        return None
    from seqid_cli.export.motions import FullModel, motions_of

    return motions_of(
        FullModel.of(arm, previous.stages), previous.inputs, replayed, folders
    )


def _unrefined(
    previous: ParameterFile, folders: Sequence[Path], motions: Motions | None
) -> Unrefined | None:
    """Return the file as it came into its refinement, for forms that are fitted."""
    if motions is None:
        return None
    from seqid_cli.export.motions import Unrefined

    return Unrefined.of(previous, folders)


def _replay(
    goal: Path,
    form: Format,
    previous: ParameterFile,
    arm: Robot,
    logs: Sequence[Path],
    loss: Mapping[str, float | None],
) -> tuple[Replay | None, list[str]]:
    """Run what was written over logs; None, and a note, where there is nothing to run."""
    if form.extent == "joints":
        return None, [f"nothing was replayed: this form holds no links ({form.title})"]
    unchecked = "nothing was checked against logs"
    if arm.locked:
        names = ", ".join(joint.name for joint in arm.locked)
        reason = f"the robot file leaves out {names}, which may stand anywhere in a log"
        return None, [f"{unchecked}: {reason}"]
    if not logs:
        lacking = "none of the held-out logs is there"
        if not held_out_logs(previous):
            lacking = "the file has no held-out log"
        return None, [f"{unchecked}: {lacking} (--replay names some)"]
    from seqid_cli.export.motions import FullModel
    from seqid_cli.export.replay import failures, replayed
    from seqid_cli.export.written.arm import UnreadableFormError
    from seqid_cli.export.written.code import NoCompilerError

    full = FullModel.of(arm, previous.stages)
    replayed_logs = [str(log) for log in logs]
    try:
        joints = replayed(goal, form.title, full, logs, loss)
    except NoCompilerError as error:
        return None, [f"{unchecked}: {error}"]
    except UnreadableFormError as error:
        said = str(error) if error.where else f"{goal}: {error}"
        nothing = Replay(logs=replayed_logs, joints={}, passed=False, failures=[said])
        return nothing, []
    failed = failures(joints, arm, goal)
    passed = not failed
    return Replay(logs=replayed_logs, joints=joints, passed=passed, failures=failed), []


def held_out_logs(file: ParameterFile) -> list[InputLog]:
    """Return the logs that a refined file was evaluated on."""
    loop = file.closed_loop
    if loop is None:
        return []
    if loop.held_out:
        return list(loop.held_out)
    # Files of earlier versions name them only, among all their inputs.
    return [entry for entry in file.inputs if entry.path in loop.evaluated_on]


def _collision(model: ExportModel, k: int) -> CollisionLimits:
    limit = float(model.observer.limit[k])
    return CollisionLimits(
        limit=limit if math.isfinite(limit) else None,
        stiction=float(model.observer.stiction[k]),
        slow=float(model.observer.slow[k]),
    )


def _link(model: ExportModel, k: int) -> ExportedLink:
    from seqid_cli.model.bodies.pseudo_inertia import Body
    from seqid_cli.robot.base_parameters import gear_ratios

    existing = model.physical or model.nearest
    body = Body.of(existing.links[k] + model.kept[k])
    return ExportedLink(
        mass=body.mass,
        center_of_mass=body.center.tolist(),
        inertia=body.inertia.tolist(),
        rotor_inertia=float(existing.rotor[k]),
        armature=float(gear_ratios(model.robot)[k] ** 2 * existing.rotor[k]),
        prior="urdf" if model.nearest.from_cad[k] else "guessed",
        friction=model.friction[k],
    )
