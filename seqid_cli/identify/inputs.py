"""What a function works on, checked before anything heavy is imported."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.identify.options import LogOptions, OnProgress
from seqid_cli.logs.given import (
    Log,
    Logs,
    PathLike,
    expanded,
    is_place,
    listed,
    optional,
    warn,
)
from seqid_cli.logs.reading import LogPart, Reading, part_of_words
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.logs.storage.remote import StoredLog
from seqid_cli.params.document import COMMAND_OF, join, present
from seqid_cli.params.encode import encode
from seqid_cli.params.files import check_output
from seqid_cli.params.io import check_robot, file_sha256, read_parameters
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot


Model: TypeAlias = "PathLike | ParameterFile"
Models: TypeAlias = "Model | Sequence[Model]"


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """What a function works on, checked; nothing heavy has been imported yet.

    `logs` are files or recordings, `missing` says which arguments stand for no log,
    where that is no reason to stop; `models` are the parameter files, `previous` what
    they hold, if given.
    """

    logs: tuple[Path | Recording, ...]
    robot: Robot
    models: tuple[tuple[str, ParameterFile], ...]
    previous: ParameterFile | None
    parameters: tuple[Path, ...]
    output: Path | None
    options: LogOptions
    missing: tuple[InputError, ...] = ()
    executor: Executor | None = None
    on_progress: OnProgress | None = None
    # What is to be said of the robot in these logs, for the result's notes.
    robot_remarks: tuple[str, ...] = ()

    @property
    def stages(self) -> Stages:
        """What had been identified before."""
        return self.previous.stages if self.previous else Stages()

    @property
    def reading(self) -> Reading:
        """By which stamps logs are read, and which part of them."""
        return with_used_parts(self.options.reading, self.documents)

    @property
    def sources(self) -> list[Path]:
        """Files that no output may replace."""
        return [*(log for log in self.logs if isinstance(log, Path)), *self.parameters]

    @property
    def documents(self) -> list[ParameterFile]:
        """The parameter files themselves."""
        return [file for _, file in self.models]

    def ids(self) -> list[FileId]:
        """The parameter files, as documents list them."""
        return [model_id(name, file, self.parameters) for name, file in self.models]


def prepare(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models = (),
    options: LogOptions | None = None,
    *,
    output: PathLike | None = None,
    more_outputs: Sequence[Path] = (),
    needs: Sequence[str] = (),
    stored: bool = True,
    executor: Executor | None = None,
    on_progress: OnProgress | None = None,
) -> Inputs:
    """Check all before numpy is imported.

    `needs`: stages that `parameters` must hold. `stored`: whether logs may be on object
    storage.
    """
    options = options or LogOptions()
    chosen, missing = _logs(listed(logs), go_on=options.skip_failed, stored=stored)
    target = optional(output)
    model_list = listed(parameters)
    model_files = tuple(
        Path(model) for model in model_list if not isinstance(model, ParameterFile)
    )
    robot_file = Path(robot) if isinstance(robot, str | os.PathLike) else robot.source
    log_files = [log for log in chosen if isinstance(log, Path)]
    for path in [target, *more_outputs]:
        if path is not None:
            check_output(path, [*log_files, robot_file, *model_files])

    models = read_models(model_list)
    previous = join(models) if models else None
    stages = present(previous.stages) if previous else {}
    for name in needs:
        if name not in stages:
            message = f"there is no {name} stage, which this command builds on"
            hint = f"Run seqid {COMMAND_OF[name]} first and give its result with -p."
            if name == "inertia":
                hint += " From logs of any motion, seqid simultaneous gives one."
            raise ConfigError(
                message, where=", ".join(file for file, _ in models), hint=hint
            )
    arm = robot_of(robot, models)
    remarks: tuple[str, ...] = ()
    if arm.locked:
        reading = with_used_parts(options.reading, [file for _, file in models])
        posture = _in_posture(chosen, arm, reading, go_on=options.skip_failed)
        arm = posture.robot
        chosen = posture.logs
        missing = (*missing, *posture.failed)
        remarks = posture.remarks
    remarks = (*remarks, *_remarks_on_followers(arm))
    return Inputs(
        logs=chosen,
        robot=arm,
        models=models,
        previous=previous,
        parameters=model_files,
        output=target,
        options=options,
        missing=missing,
        executor=executor,
        on_progress=on_progress,
        robot_remarks=remarks,
    )


def _remarks_on_followers(robot: Robot) -> list[str]:
    """Say which joints of the robot file are left out, as they mimic another."""
    return [
        f"{joint.name} is left out: it follows {joint.follows} (mimic) and has no drive"
        " of its own"
        for joint in robot.followers
    ]


@dataclass(frozen=True, kw_only=True)
class _Posture:
    """A robot whose left-out joints stand where the logs have them.

    `logs` are those that can be used, `failed` says why others cannot, `remarks` what
    is to be said of joints that stand.
    """

    robot: Robot
    logs: tuple[Path | Recording, ...]
    failed: list[InputError]
    remarks: tuple[str, ...]


def _in_posture(
    logs: tuple[Path | Recording, ...],
    robot: Robot,
    reading: Reading,
    *,
    go_on: bool,
) -> _Posture:
    """Take joints that the robot file leaves out where they stand in the logs.

    With `go_on` a log that cannot be used is no reason to stop.
    """
    from seqid_cli.logs.left_out import Standing, in_logged_posture, standing_joints

    usable: list[Path | Recording] = []
    standing: list[Standing] = []
    failed: list[InputError] = []
    arm = robot
    for log in logs:
        of_log = standing_joints(log, robot, reading) if isinstance(log, Path) else []
        try:
            arm = in_logged_posture(robot, [*standing, *of_log])
        except InputError as error:
            if not go_on:
                raise
            failed.append(error)
            warn(f"left out: {error}")
            continue
        usable.append(log)
        standing += of_log
    if failed and not usable:
        raise failed[0]

    first_of_joint: dict[str, Standing] = {}
    for joint in standing:
        if joint.message:
            first_of_joint.setdefault(joint.joint.name, joint)
    remarks = tuple(
        f"[joint_stands] {joint.log}: {name} {joint.message}"
        for name, joint in first_of_joint.items()
    )
    for text in remarks:
        warn(text)
    return _Posture(robot=arm, logs=tuple(usable), failed=failed, remarks=remarks)


def with_used_parts(reading: Reading, files: Iterable[ParameterFile]) -> Reading:
    """Return how logs are read, with the parts of logs that files say were used.

    A log of which stages used different parts is read as a whole.
    """
    parts: dict[str, set[LogPart]] = {}
    for file in files:
        held_out = file.closed_loop.held_out if file.closed_loop else []
        for log in (*file.inputs, *held_out):
            parts.setdefault(log.sha256, set()).add(part_of_words(log.part))
    part_by_sha256 = {
        sha256: next(iter(used))
        for sha256, used in parts.items()
        if len(used) == 1 and any(used)
    }
    return replace(reading, part_by_sha256=part_by_sha256)


def read_models(sources: Sequence[Model]) -> tuple[tuple[str, ParameterFile], ...]:
    """Return parameter files with the names to use in messages."""
    models: list[tuple[str, ParameterFile]] = []
    for model in sources:
        if isinstance(model, ParameterFile):
            models.append(("the given parameters", model))
        else:
            models.append((str(model), read_parameters(Path(model))))
    return tuple(models)


def robot_of(
    robot: PathLike | Robot, models: Sequence[tuple[str, ParameterFile]]
) -> Robot:
    """Return the robot, after a check that the parameter files are of it.

    Warns of changes.
    """
    loaded = load_robot(Path(robot)) if isinstance(robot, str | os.PathLike) else robot
    for name, file in models:
        for warning in check_robot(file, loaded, where=name):
            warn(warning)
    return loaded


def model_id(name: str, file: ParameterFile, paths: Sequence[Path]) -> FileId:
    """Return a parameter file as documents list it."""
    if name in map(str, paths):
        return FileId(path=name, sha256=file_sha256(Path(name)))
    return FileId(path="", sha256=hashlib.sha256(encode(file).encode()).hexdigest())


def _logs(
    requested: Sequence[Log], *, go_on: bool, stored: bool
) -> tuple[tuple[Path | Recording, ...], tuple[InputError, ...]]:
    """Return the logs, and errors of missing ones where `go_on` allows these."""
    if not requested:
        raise UsageError(
            "no log is given",
            hint="Give files, folders, globs, tables or recordings.",
        )
    present_logs: list[Log] = []
    missing: list[InputError] = []
    for log in requested:
        try:
            if go_on and is_place(log):
                expand([os.fspath(log)], stored=stored)  # type: ignore[arg-type]
            present_logs.append(log)
        except InputError as error:
            missing.append(error)
            warn(f"left out: {error}")
    if missing and not present_logs:
        raise missing[0]
    files = expanded(present_logs, stored=stored)
    for file in files:
        if not go_on and isinstance(file, Path) and not isinstance(file, StoredLog):
            check_log(file)
    return tuple(files), tuple(missing)


def imu_stage_for(source: str) -> tuple[str, ...]:
    """Return the stages that a source of motion insists on."""
    return ("imu",) if source in ("imu", "fused") else ()
