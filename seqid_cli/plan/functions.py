"""Planning as a function: a robot file and parameters in, the moves to record out."""

from __future__ import annotations

from collections.abc import Sized
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.identify.inputs import (
    Models,
    model_id,
    read_models,
    robot_of,
    with_used_parts,
)
from seqid_cli.logs.given import Logs, PathLike, expanded, is_place, listed, optional
from seqid_cli.logs.reading import Reading
from seqid_cli.params.document import join
from seqid_cli.params.files import check_output, writing
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.plan.options import PlanOptions, What
from seqid_cli.plan.settings import MarginSettings, PlanSettings

if TYPE_CHECKING:
    from seqid_cli.plan.limits import Limits
    from seqid_cli.plan.moves.floor import Floor
    from seqid_cli.robot.types import Robot
    from seqid_cli.robot.urdf_model import Geometry


def plan(
    what: What,
    robot: PathLike | Robot,
    parameters: Models = (),
    options: PlanOptions = PlanOptions(),
    *,
    settings: PlanSettings = PlanSettings(),
    have: Logs = (),
    output: PathLike | None = None,
    trajectories: PathLike | None = None,
) -> PlanFile:
    """Plan the moves to record next, and the standard errors that they will give.

    Parameters
    ----------
    what : {"friction", "gravity", "imu-calib", "inertia", "payload", "drive", \
"validation", "all", "discriminate"}
        The stage to record for, a whole session, or the question which of two effects
        it is.
    robot : path or Robot
        Limits are the tighter of the robot file's and its URDF's.
    parameters : path or ParameterFile, or a sequence of them
        What is identified already: torque and noise are taken from it.
    options : PlanOptions
    settings : PlanSettings
        Numbers that decide; `seqid plan --show-settings` lists them.
    have : path, table, recording, or a sequence of them
        Logs that the inertia stage, or the diagnosis that tells two effects apart, gets
        as well.
    output, trajectories : path, optional
        Where the plan goes, and the folder for the files of each move.

    Returns
    -------
    PlanFile
        The moves, their predicted standard errors, and what was assumed of limits,
        floor and noise.

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    model_inputs = listed(parameters)
    log_inputs = listed(have)
    target = optional(output)
    folder = optional(trajectories)

    # Places to write to and options are checked before anything is read.
    model_paths = [
        Path(model) for model in model_inputs if not isinstance(model, ParameterFile)
    ]
    input_paths = list(model_paths)
    if is_place(robot):
        input_paths.insert(0, Path(robot))  # type: ignore[arg-type]
    if target is not None:
        check_output(target, input_paths)
    if folder is not None:
        _check_folder(folder)
    _check_options(what, options, model_inputs, log_inputs)
    log_paths = expanded(log_inputs)

    # The robot file comes first: its faults are reported before a parameter file's
    # faults.
    arm = robot_of(robot, ())
    models = read_models(model_inputs)
    robot_of(arm, models)
    stages = join(models).stages if models else Stages()

    # Imported here, so that mistakes in options and files are reported at once.
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.plan.limits import limits_of
    from seqid_cli.plan.make import make_plan

    limits = limits_of(
        arm, ramp_s=options.ramp_s, share=options.share, locked=options.locked
    )
    reading = with_used_parts(
        Reading(part=options.part), [model for _, model in models]
    )
    logs = LogSet(logs=log_paths, robot=arm, reading=reading)
    geometry = _geometry(arm, limits, options)
    floor = None
    if options.floor:
        floor = _floor(arm, limits, geometry, settings.margins)
    file = make_plan(
        what,
        arm,
        limits,
        stages,
        options,
        parameters=[model_id(name, model, model_paths) for name, model in models],
        have=logs.again(imus=False),
        geometry=geometry,
        floor=floor,
        settings=settings,
    )
    file = structs.replace(file, created=logs.created(model for _, model in models))

    if folder is not None:
        from seqid_cli.plan.moves.files import write_moves

        with writing(folder):
            folder.mkdir(exist_ok=True)
        moves = write_moves(folder, file.moves, arm, options.speed_scale)
        file = structs.replace(file, moves=moves)
    if target is not None:
        write_json_atomic(target, file, inputs=input_paths)
    return file


def _check_folder(folder: Path) -> None:
    """Refuse a folder for the files of the moves that cannot be written to."""
    if folder.exists() and not folder.is_dir():
        hint = "Name a folder for the files of the moves."
        raise UsageError("is a file, not a folder", where=str(folder), hint=hint)
    check_output(folder.parent / f"{folder.name}.csv")


def _check_options(
    plan_name: str, options: PlanOptions, parameters: Sized, have: Sized
) -> None:
    """Refuse options that contradict each other."""
    if options.duration_s < options.length_s:
        message = (
            f"--duration {options.duration_s:g} s is shorter than one move of"
            f" {options.length_s:g} s"
        )
        raise UsageError(message, hint="Give more time, or a shorter --move-duration.")

    if plan_name in ("payload", "discriminate") and not parameters:
        hint = "Give -p with the result of seqid inertia."
        raise UsageError(
            f"{plan_name} is planned for a model that is identified", hint=hint
        )
    if (plan_name == "discriminate") != bool(options.between):
        hint = (
            "As in plan discriminate --between stribeck,quadratic_drag --joint elbow."
        )
        raise UsageError(
            "discriminate needs --between, and no other plan takes it", hint=hint
        )
    if have and plan_name not in ("inertia", "all", "discriminate"):
        hint = "Leave it out, or plan the inertia stage."
        raise UsageError(
            f"--have counts for inertia and discriminate, not for {plan_name}",
            hint=hint,
        )
    if options.part and not have:
        hint = "Name the logs with --have, or leave it out."
        raise UsageError(
            "--from, --to and --exclude take a part of the logs of --have", hint=hint
        )


def _geometry(robot: Robot, limits: Limits, options: PlanOptions) -> Geometry | None:
    """Return the arm's shapes and the boxes; None where the URDF has no shapes."""
    import numpy as np

    from seqid_cli.plan.moves.strokes import postures_of
    from seqid_cli.robot.urdf_model import geometry_of

    postures = postures_of(limits, 200, np.random.default_rng(0))
    geometry = geometry_of(robot, postures, options.keep_out, options.workspace)
    if geometry is None and (options.keep_out or options.workspace):
        hint = (
            "Give a URDF with <collision> shapes and their meshes, or leave the boxes"
            " out."
        )
        message = "--workspace and --keep-out need the shapes of the links"
        raise ConfigError(message, where=str(robot.source), hint=hint)
    return geometry


def _floor(
    robot: Robot, limits: Limits, geometry: Geometry | None, margins: MarginSettings
) -> Floor | None:
    """Return the base plane as the floor; None where no joint lifts anything."""
    import numpy as np

    from seqid_cli.plan.moves.floor import floor_of
    from seqid_cli.plan.moves.strokes import postures_of

    postures = postures_of(limits, 500, np.random.default_rng(0))
    return floor_of(robot, limits, postures, geometry, margins=margins)
