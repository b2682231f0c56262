"""The function `replay`: logs and a drive in, a simulation against them out."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Unpack

from seqid_cli.drive.options import ReplayOptions
from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.identify.inputs import Inputs, prepare
from seqid_cli.identify.options import Keywords, documented
from seqid_cli.logs.given import Logs, PathLike
from seqid_cli.params.document import head, present, robot_id, worst_level
from seqid_cli.params.encode import encode
from seqid_cli.params.io import check_robot, file_sha256, read_drive, write_json_atomic
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.replay import REPLAY_SCHEMA, ReplayFile, ReplayJoint
from seqid_cli.params.schema import InputLog, Verdict

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

Drive: TypeAlias = "PathLike | DriveFile"


@documented(Keywords)
def replay(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Drive,
    options: ReplayOptions = ReplayOptions(),
    **keywords: Unpack[Keywords],
) -> ReplayFile:
    """Simulate the robot from its commands, and compare it with its logs.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Motions under position control, with `<joint>.command`; best not those that the
        drive was fitted to.
    parameters : path or DriveFile
        The drive, which holds the model of the arm as well.
    """
    if not options.window_s > 0.0:
        raise UsageError(
            f"a window of {options.window_s:g} s is none", hint="Give seconds above 0."
        )
    drive, name = _drive_of(parameters)
    inputs = prepare(logs, robot, (), options, **keywords)
    check_robot(drive, inputs.robot, where=name)
    _check_complete(drive, inputs, name)

    # Imported here because they import numpy: a mistake in the arguments is told first.
    from seqid_cli.drive.effects import arm_effects
    from seqid_cli.drive.functions import logs_with_commands
    from seqid_cli.drive.signals import signals_of
    from seqid_cli.drive.windows import (
        closed_loop,
        joints_of,
        replayed,
        step_responses,
        windows_of,
    )
    from seqid_cli.identify.log_set import LogSet

    log_set = LogSet.of(inputs, imus=False)
    effects = arm_effects(drive.stages, inputs.robot)
    recordings = [effects.restored(log) for log in logs_with_commands(list(log_set))]
    has_torque = all(log.tau is not None for log in recordings)
    signals = [
        signals_of(
            log,
            effects.model,
            cutoff_hz=options.cutoff_hz,
            use_torque=has_torque,
            effects=effects,
        )
        for log in recordings
    ]
    driven = [
        j for j, name in enumerate(inputs.robot.joint_names) if name in drive.joints
    ]
    windows = windows_of(signals, options.window_s, driven)
    if not windows:
        raise InputError(
            f"no {options.window_s:g} s in which every joint with a controller has"
            " position and command",
            hint="Record longer, or give a shorter --window.",
            where=str(recordings[0].path),
        )
    loop = closed_loop(drive, effects.model, signals, effects)
    results = replayed(loop, drive, windows)
    steps = step_responses(loop, drive, windows)
    joints = dict(joints_of(drive, results, steps))
    of_joints = [_verdict(name, joint) for name, joint in joints.items()]
    level = worst_level(of_joints) or "poor"
    behind = [verdict.joint for verdict in of_joints if not verdict.good]
    file = ReplayFile(
        **head(REPLAY_SCHEMA, log_set.created([drive])),
        robot=robot_id(inputs.robot),
        inputs=log_set.inputs(),
        drive=_id_of(drive, name),
        window_s=options.window_s,
        windows=len(windows),
        step_s=max(result.step_s for result in results),
        joints=joints,
        verdicts=[
            Verdict(
                good=level == "good",
                level=level,
                reason="" if not behind else f"{', '.join(behind)}: see there",
            ),
            *log_set.verdicts(),
            *of_joints,
        ],
        notes=[
            *log_set.notes(),
            *_notes(drive, name, log_set.inputs()),
            *effects.left_out,
        ],
    )
    if inputs.output is not None:
        sources = [*inputs.sources]
        if not isinstance(parameters, DriveFile):
            sources.append(Path(parameters))
        write_json_atomic(inputs.output, file, inputs=sources)
    return file


def _drive_of(parameters: Drive) -> tuple[DriveFile, str]:
    """Return the drive and its name in messages."""
    if isinstance(parameters, DriveFile):
        return parameters, "the given drive"
    return read_drive(Path(parameters)), str(parameters)


def _id_of(drive: DriveFile, name: str) -> FileId:
    if Path(name).is_file():
        return FileId(path=name, sha256=file_sha256(Path(name)))
    return FileId(path="", sha256=hashlib.sha256(encode(drive).encode()).hexdigest())


def _check_complete(drive: DriveFile, inputs: Inputs, name: str) -> None:
    """Raise ConfigError where the drive cannot move the whole arm."""
    if "inertia" not in present(drive.stages):
        raise ConfigError(
            "holds no inertia, without which nothing can be simulated",
            where=name,
            hint="Run seqid drive with the result of seqid inertia or simultaneous.",
        )
    if not drive.joints:
        raise ConfigError(
            f"has no controller of joint {', '.join(inputs.robot.joint_names)}",
            where=name,
            hint="Its verdicts say why; record what they ask for.",
        )


def _verdict(name: str, joint: ReplayJoint) -> Verdict:
    """Judge a joint by the guesses that need no model."""
    guess = min(joint.delayed_command.rms, joint.start_plus_change.rms)
    error = joint.position.rms
    if error <= guess:
        return Verdict(joint=name, good=True)
    reason = (
        f"its position is off by {error:.2g}, the delayed command only by {guess:.2g}:"
        " the simulation adds nothing here"
    )
    return Verdict(joint=name, good=False, reason=reason)


def _notes(drive: DriveFile, drive_name: str, logs: Sequence[InputLog]) -> list[str]:
    """Say what a reader must know besides."""
    fitted = {log.sha256 for log in drive.inputs}
    notes = []
    if any(log.sha256 in fitted for log in logs):
        notes.append("some of these logs were fitted: the errors are no forecast")
    without = [name for name in drive.robot.joints if name not in drive.joints]
    if without:
        notes.append(
            f"{', '.join(without)}: no controller in {drive_name}, moves as measured"
        )
    return notes
