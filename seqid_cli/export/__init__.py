"""Identified models in the forms that other tools read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import ConfigError
from seqid_cli.export.drives import (
    drive_model,
    drive_notes,
    drive_of,
    mjcf_with_drives,
)
from seqid_cli.export.formats import BY_TITLE, Format, format_of
from seqid_cli.export.formats import export as export_form
from seqid_cli.identify.inputs import (
    Models,
    model_id,
    read_models,
    robot_of,
    with_used_parts,
)
from seqid_cli.logs.given import PathLike, listed
from seqid_cli.logs.reading import ALL, HEADER_STAMPS, LogPart, Reading
from seqid_cli.logs.storage.files import expand
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import head, join, present, robot_id
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.io import file_sha256
from seqid_cli.params.results.drive import DriveFile
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
    from seqid_cli.export.motions import FoundLogs, Motions, Unrefined
    from seqid_cli.robot.types import Robot

_UNCHECKED = "nothing was checked against logs"


def export(
    parameters: Models,
    robot: PathLike,
    output: PathLike,
    *,
    target: str | None = None,
    replay: Sequence[PathLike] = (),
    no_replay: bool = False,
    part: LogPart = ALL,
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
    part : LogPart
        The part of each log that is replayed; by default the part that the file used of
        it, or else all of it.

    Returns
    -------
    ExportFile
        Its `replay` says whether what was written is as good as it states.
    """
    robot_path = Path(robot)
    output_path = Path(output)
    models_or_paths = listed(parameters)
    form = BY_TITLE[format_of(output_path, target)]
    paths = [
        Path(model) for model in models_or_paths if not isinstance(model, ParameterFile)
    ]
    check_output(output_path, [*paths, robot_path])
    if form.extent == "load":
        return _export_load(form, paths, robot_path, output_path)

    drive = drive_of(paths)
    if drive is not None:
        return _export_drive(drive, form, paths[0], robot_path, output_path)

    models = read_models(models_or_paths)
    file = join(models)
    arm = robot_of(robot_path, models)
    if arm.urdf is not None:
        check_output(output_path, [arm.urdf])

    # Logs are looked for where their entries say, and beside the files.
    folders = list(dict.fromkeys([*(path.parent for path in paths), robot_path.parent]))
    logs = _logs_to_replay(file, folders, replay)
    used = with_used_parts(HEADER_STAMPS, [file])
    replay_reading = replace(used, part=part)
    motions = _motions(file, arm, folders, form, logs.files, replay_reading)

    exported = export_form(
        arm,
        file.stages,
        kind=form.title,
        errors=_held_out_errors(file),
        unrefined=_unrefined(file, folders, motions),
        motions=motions,
    )
    write_text_atomic(output_path, exported.text)

    model = exported.model
    notes = list(model.notes)
    loss: dict[str, float | None] = {}
    loss_range: dict[str, list[float]] = {}
    loss_on_replayed: dict[str, float | None] = {}
    if model.loss is not None:
        loss = model.loss.stated(arm.joint_names)
        loss_range = model.loss.ranges(arm.joint_names)
        loss_on_replayed = model.loss.on_replayed(arm.joint_names)

    replay_result = None
    if no_replay:
        notes.append(f"{_UNCHECKED} (--no-replay)")
    else:
        checked = _check(
            output_path,
            form,
            file,
            arm,
            logs.files,
            loss_on_replayed,
            reading=replay_reading,
        )
        replay_result = checked.replay
        notes += [f"{reason}: it is not replayed" for reason in logs.lost]
        notes += checked.notes

    return ExportFile(
        **head(EXPORT_SCHEMA, file.created),
        robot=robot_id(arm),
        format=form.title,
        path=str(output_path),
        parameters=[model_id(name, model_file, paths) for name, model_file in models],
        stages=list(present(file.stages)),
        exact=model.nearest.exact,
        largest_deviation=model.largest_deviation,
        base_parameters=list(model.deviations),
        joints={name: _link(model, j) for j, name in enumerate(arm.joint_names)},
        refitted=model.refitted,
        fitted_on=(
            [] if motions is None else [str(log.path) for log in motions.recordings]
        ),
        loss=loss,
        loss_range=loss_range,
        replay=replay_result,
        observer_gain=float(model.observer.gain),
        collision={
            name: _collision(model, j) for j, name in enumerate(arm.joint_names)
        },
        notes=notes,
    )


def _export_drive(
    drive: DriveFile, form: Format, path: Path, robot_path: Path, output_path: Path
) -> ExportFile:
    """Write an arm with the drives that were identified."""
    from seqid_cli.export.drive_targets import WRITERS, notes

    is_mjcf = form.target in ("mujoco", "mujoco-position")
    if not is_mjcf and form.target not in WRITERS:
        targets = ", ".join(["mujoco-position", *WRITERS])
        raise ConfigError(
            f"a drive is not written as {form.title}",
            where=str(path),
            hint=f"Choose --target {targets}, or give the result of seqid inertia for"
            " the arm alone.",
        )
    model = drive_model(drive, robot_path, path)
    if is_mjcf:
        text = mjcf_with_drives(model, drive)
        lacking = drive_notes(drive)
    else:
        text = WRITERS[form.target](model, drive)
        lacking = notes(drive, form.target)
    write_text_atomic(output_path, text)
    names = model.robot.joint_names
    return ExportFile(
        **head(EXPORT_SCHEMA, drive.created),
        robot=robot_id(model.robot),
        format=form.title,
        path=str(output_path),
        parameters=[FileId(path=str(path), sha256=file_sha256(path))],
        stages=list(present(drive.stages)),
        exact=model.nearest.exact,
        largest_deviation=model.largest_deviation,
        base_parameters=list(model.deviations),
        joints={name: _link(model, j) for j, name in enumerate(names)},
        notes=[*model.notes, *lacking, f"{_UNCHECKED}: see seqid replay"],
    )


def _export_load(
    form: Format, paths: Sequence[Path], robot_path: Path, output_path: Path
) -> ExportFile:
    """Write what a robot carries as its controller takes it."""
    from seqid_cli.export.loads import load_setting, read_load

    arm = load_robot(robot_path)
    source = read_load(paths)
    write_text_atomic(output_path, load_setting(source, arm, form.title))
    return ExportFile(
        **head(EXPORT_SCHEMA, created_from((), otherwise=Path(source.path))),
        robot=robot_id(arm),
        format=form.title,
        path=str(output_path),
        parameters=[FileId(path=source.path, sha256=source.sha256)],
        stages=[],
        exact=True,
        largest_deviation=0.0,
        base_parameters=[],
        joints={},
        notes=["nothing was replayed: a load is not a model of the arm"],
    )


def _held_out_errors(file: ParameterFile) -> dict[str, float] | None:
    """Return the RMS error [N m] of each joint on held-out logs, None without any."""
    closed_loop = file.closed_loop
    if closed_loop is None:
        return None
    return {name: joint.rmse for name, joint in closed_loop.after.items()}


def _logs_to_replay(
    file: ParameterFile, folders: Sequence[Path], replay: Sequence[PathLike]
) -> FoundLogs:
    """Return the logs that were asked for, or else the held-out logs of the file."""
    from seqid_cli.export.motions import FoundLogs, find_logs

    if replay:
        paths = expand([str(log) for log in replay])
        return FoundLogs(files=tuple(Path(path) for path in paths), lost=())
    return find_logs(held_out_logs(file), folders)


def _motions(
    file: ParameterFile,
    arm: Robot,
    folders: Sequence[Path],
    form: Format,
    replayed_logs: Sequence[Path],
    replay_reading: Reading,
) -> Motions | None:
    """Return the motions that a form is fitted to; None if it holds the whole model."""
    if form.extent == "whole" or arm.locked:
        return None
    from seqid_cli.export.motions import FullModel, motions_of

    full = FullModel.of(arm, file.stages, with_used_parts(HEADER_STAMPS, [file]))
    return motions_of(
        full,
        file.inputs,
        replayed_logs,
        folders,
        held_out_reading=replay_reading,
    )


def _unrefined(
    file: ParameterFile, folders: Sequence[Path], motions: Motions | None
) -> Unrefined | None:
    """Return the file as it came into its refinement, for forms that are fitted."""
    if motions is None:
        return None
    from seqid_cli.export.motions import Unrefined

    return Unrefined.of(file, folders)


@dataclass(frozen=True, kw_only=True)
class _Check:
    """The replay of what was written, or None and a note that says why."""

    replay: Replay | None = None
    notes: tuple[str, ...] = ()


def _check(
    output_path: Path,
    form: Format,
    file: ParameterFile,
    arm: Robot,
    logs: Sequence[Path],
    loss: Mapping[str, float | None],
    *,
    reading: Reading,
) -> _Check:
    """Run what was written over logs, where there is something to run.

    Parameters
    ----------
    output_path : Path
        What was written.
    form : Format
        Its form.
    file : ParameterFile
        The file that it was written from.
    arm : Robot
        The arm of both.
    logs : sequence of Path
        Logs with torque.
    loss : mapping of str to float or None
        What the form states to lose on these logs, by joint, N m (N where prismatic).
    reading : Reading
        Which part of each log is replayed.
    """
    reason = _reason_for_no_replay(form, file, arm, logs)
    if reason is not None:
        return _Check(notes=(reason,))

    from seqid_cli.export.motions import FullModel
    from seqid_cli.export.replay import failures, replayed
    from seqid_cli.export.written.arm import UnreadableFormError
    from seqid_cli.export.written.code import NoCompilerError

    full = FullModel.of(arm, file.stages, reading)
    names = [str(log) for log in logs]
    try:
        joints = replayed(output_path, form.title, full, logs, loss)
    except NoCompilerError as error:
        return _Check(notes=(f"{_UNCHECKED}: {error}",))
    except UnreadableFormError as error:
        # What cannot be run has failed, whatever its numbers are.
        message = str(error) if error.where else f"{output_path}: {error}"
        return _Check(
            replay=Replay(logs=names, joints={}, passed=False, failures=[message])
        )

    messages = failures(joints, arm, output_path)
    return _Check(
        replay=Replay(logs=names, joints=joints, passed=not messages, failures=messages)
    )


def _reason_for_no_replay(
    form: Format, file: ParameterFile, arm: Robot, logs: Sequence[Path]
) -> str | None:
    """Say why a form cannot be replayed; return None where it can."""
    if form.extent == "joints":
        return f"nothing was replayed: this form holds no links ({form.title})"
    if arm.locked:
        names = ", ".join(joint.name for joint in arm.locked)
        return (
            f"{_UNCHECKED}: the robot file leaves out {names}, which may stand anywhere"
            " in a log"
        )
    if not logs:
        lacking = "the file has no held-out log"
        if held_out_logs(file):
            lacking = "none of the held-out logs is there"
        return f"{_UNCHECKED}: {lacking} (--replay names some)"
    return None


def held_out_logs(file: ParameterFile) -> list[InputLog]:
    """Return the logs that a refined file was evaluated on."""
    closed_loop = file.closed_loop
    if closed_loop is None:
        return []
    if closed_loop.held_out:
        return list(closed_loop.held_out)
    # Files of earlier versions name them only, among all their inputs.
    return [entry for entry in file.inputs if entry.path in closed_loop.evaluated_on]


def _collision(model: ExportModel, joint: int) -> CollisionLimits:
    """Return the limits of a joint's external torque, as the result states them."""
    limit = float(model.observer.limit[joint])
    return CollisionLimits(
        limit=limit if math.isfinite(limit) else None,
        stiction=float(model.observer.stiction[joint]),
        slow=float(model.observer.slow[joint]),
    )


def _link(model: ExportModel, joint: int) -> ExportedLink:
    """Return the body, rotor and friction of a joint, as the result states them."""
    from seqid_cli.model.bodies.pseudo_inertia import Body
    from seqid_cli.robot.base_parameters import gear_ratios

    # Code has links that no body need have: the result states those that can exist.
    bodies = model.physical or model.nearest
    body = Body.of(bodies.links[joint] + model.locked_links[joint])
    gear_ratio = gear_ratios(model.robot)[joint]
    return ExportedLink(
        mass=body.mass,
        center_of_mass=body.center.tolist(),
        inertia=body.inertia.tolist(),
        rotor_inertia=float(bodies.rotor[joint]),
        armature=float(gear_ratio**2 * bodies.rotor[joint]),
        prior="urdf" if model.nearest.from_cad[joint] else "guessed",
        friction=model.friction[joint],
    )
