"""The function `drive`: logs with commands and a model in, the controllers out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from seqid_cli.drive.options import DriveOptions
from seqid_cli.drive.settings import DriveSettings
from seqid_cli.errors import ConfigError, InputError
from seqid_cli.identify.inputs import Inputs, Models, prepare
from seqid_cli.identify.options import Keywords, documented
from seqid_cli.logs.given import Logs, PathLike
from seqid_cli.params.document import present
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.drive import DriveFile

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot


@documented(Keywords)
def drive(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models = (),
    options: DriveOptions = DriveOptions(),
    *,
    settings: DriveSettings = DriveSettings(),
    **keywords: Unpack[Keywords],
) -> DriveFile:
    """Identify the position controller of each joint from its commands.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Motions under position control, with `<joint>.command`.
    parameters : path or ParameterFile, or a sequence of them, optional
        The model of the arm. Without one it is that of the URDF's inertials, and the
        logs have to tell friction and rotor inertia as well.
    """
    inputs = prepare(logs, robot, parameters, options, **keywords)
    nominal = not inputs.models
    _check_model(inputs)

    # Imported here because they import numpy: a mistake in the arguments is told first.
    from seqid_cli.drive.checks import (
        fault_of_command,
        has_command,
        joints_beside,
        remarks_on_commands,
    )
    from seqid_cli.drive.effects import arm_effects
    from seqid_cli.drive.fit import fit_joint
    from seqid_cli.drive.nominal import nominal_stages
    from seqid_cli.drive.result import DrivenArm, drive_file, explains
    from seqid_cli.drive.rollouts.joints import fit_all_windows
    from seqid_cli.drive.signals import signals_of
    from seqid_cli.identify.log_set import LogSet

    log_set = LogSet.of(inputs, imus=False)
    recordings = list(log_set)
    stages = nominal_stages(inputs.robot) if nominal else inputs.stages
    effects = arm_effects(stages, inputs.robot)
    with_commands = [effects.restored(log) for log in logs_with_commands(recordings)]
    use_torque = not options.no_torque and all(
        log.tau is not None for log in with_commands
    )
    wide, narrow = (
        [
            signals_of(
                log,
                effects.model,
                cutoff_hz=options.cutoff_hz,
                use_torque=use_torque,
                share=share,
                effects=effects,
            )
            for log in with_commands
        ]
        for share in (1.0, 0.5)
    )

    faults = {}
    by_rows = {}
    remarks = [
        *effects.left_out,
        *joints_beside(inputs.logs, inputs.robot),
        *remarks_on_commands(wide, recordings, inputs.robot),
    ]
    n_commanded = sum(has_command(wide, j) for j in range(inputs.robot.n))
    for j, name in enumerate(inputs.robot.joint_names):
        fault = fault_of_command(wide, j)
        if n_commanded and not has_command(wide, j):
            # Nothing was asked of it: a gripper, say, that another bus drives.
            remarks.append(f"{name} is left out: {fault}")
        elif fault:
            faults[name] = fault
        else:
            by_rows[j] = fit_joint(wide, narrow, j, settings)
    by_windows = {}
    if settings.windows.most:
        usable = {
            j: fit if fit is not None and explains(fit, settings.verdict) else None
            for j, fit in by_rows.items()
        }
        by_windows = fit_all_windows(
            wide,
            effects.model,
            usable,
            settings,
            effects=effects,
            nominal=nominal,
            same_servos=options.same_servos,
        )
    arm = DrivenArm(
        inputs=inputs,
        stages=stages,
        logs=wide,
        log_set=log_set,
        nominal=nominal,
        remarks=remarks,
    )
    file = drive_file(by_rows, by_windows, faults, arm, settings)
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file


def _check_model(inputs: Inputs) -> None:
    """Raise ConfigError where neither file nor URDF holds a rigid body."""
    hint = "Give the result of seqid inertia, or of seqid simultaneous."
    if not inputs.models:
        if inputs.robot.nominal is None:
            raise ConfigError(
                "names no URDF with inertials that could stand for a model of the arm",
                where=str(inputs.robot.source),
                hint=hint,
            )
        return
    if {"gravity", "inertia"} & present(inputs.stages).keys():
        return
    where = ", ".join(name for name, _ in inputs.models)
    raise ConfigError("holds no rigid body", where=where, hint=hint)


def logs_with_commands(recordings: list[Recording]) -> list[Recording]:
    """Return the logs with commanded positions; raises InputError where none has."""
    chosen = [log for log in recordings if log.command is not None]
    if chosen:
        return chosen
    first = recordings[0]
    other = [
        quantity
        for quantity, values in (
            ("velocity", first.command_velocity),
            ("torque", first.command_torque),
        )
        if values is not None
    ]
    message = "the log has no commanded position"
    if other:
        message += f", but commands of {' and '.join(other)}"
    raise InputError(
        message,
        hint="Log <joint>.command, what the controller is asked for; or name it in the"
        ' robot file: [channels] command = "...", or command_topic.',
        where=str(first.path),
    )
