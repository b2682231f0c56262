"""The way that every command on logs goes: cheap checks first, then reading with an account."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.commands.options import TimeSource
from seqid_cli.commands.progress import ProgressLine
from seqid_cli.commands.render import Screen
from seqid_cli.errors import ConfigError
from seqid_cli.logs.open import check_log, expand
from seqid_cli.params.document import join, present
from seqid_cli.params.files import check_output
from seqid_cli.params.io import check_robot, read_parameters
from seqid_cli.params.schema import InputLog, ParameterFile, Stages
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot

EXIT_DONE, EXIT_UNTRUSTED, EXIT_PARTIAL = 0, 1, 3
_WRITTEN_BY = {
    "friction": "friction",
    "gravity": "gravity",
    "imu": "imu-calib",
    "inertia": "inertia",
}


@dataclass(frozen=True)
class Job:
    """Everything that a command works on, checked; nothing heavy has been imported yet.

    `files` are the logs, `previous` the joined parameter files (None where none was given).
    """

    screen: Screen
    files: tuple[Path, ...]
    robot: Robot
    previous: ParameterFile | None
    parameters: tuple[Path, ...]
    output: Path | None
    time_source: TimeSource

    @property
    def stages(self) -> Stages:
        """What had been identified before."""
        return self.previous.stages if self.previous else Stages()


def prepare(
    screen: Screen,
    logs: Sequence[str],
    robot: Path,
    parameters: Sequence[Path],
    *,
    output: Path | None,
    more_outputs: Sequence[Path] = (),
    time_source: TimeSource = "header",
    needs: Sequence[str] = (),
) -> Job:
    """Check all that can be checked before numpy is imported.

    `needs` names the stages that `parameters` must hold.

    Raises
    ------
    SeqidError
        A path, the robot file or a parameter file is wrong.
    """
    files = expand(logs, screen.warn)
    for file in files:
        check_log(file)
    for path in [output, *more_outputs]:
        if path is not None:
            check_output(path, [*files, robot, *parameters])
    parts = [(str(path), read_parameters(path)) for path in parameters]
    previous = join(parts) if parts else None
    _require(needs, previous, parameters)
    loaded = load_robot(robot)
    for name, part in parts:
        for warning in check_robot(part, loaded, where=name):
            screen.warn(warning)
    return Job(screen, tuple(files), loaded, previous, tuple(parameters), output, time_source)


def _require(
    needs: Sequence[str], previous: ParameterFile | None, parameters: Sequence[Path]
) -> None:
    there = present(previous.stages) if previous else {}
    for name in needs:
        if name not in there:
            message = f"there is no {name} stage, which this command builds on"
            hint = f"Run seqid {_WRITTEN_BY[name]} first and give its result with -p."
            raise ConfigError(message, where=", ".join(map(str, parameters)), hint=hint)


class Account:
    """Passes recordings on and keeps account of them.

    Iterate over it once; `inputs` and `partial` are complete afterwards. Health warnings go to the
    screen as they come.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._progress = ProgressLine(len(job.files), sys.stderr, enabled=not job.screen.quiet)
        self._logs: list[tuple[str, str, int]] = []
        self.partial: list[str] = []

    def __iter__(self) -> Iterator[Recording]:
        """Read the logs one after the other."""
        from seqid_cli.logs.read import read_recordings

        job = self._job
        try:
            self._progress.show(0, job.files[0].name)
            for recording in read_recordings(job.files, job.robot, time_source=job.time_source):
                self._note(recording)
                yield recording
                self._progress.show(len(self._logs), recording.path.name)
        finally:
            self._progress.clear()

    def inputs(self, stage: str = "") -> list[InputLog]:
        """Return the logs read so far, as documents list them."""
        return [
            InputLog(path=path, sha256=sha256, samples=samples, stage=stage)
            for path, sha256, samples in self._logs
        ]

    def _note(self, recording: Recording) -> None:
        self._progress.clear()
        path, samples = str(recording.path), len(recording.t)
        self._logs.append((path, recording.sha256, samples))
        self._job.screen.detail(f"{path}: {samples} samples at {recording.rate_hz:.6g} Hz")
        for warning in recording.health.warnings:
            self._job.screen.warn(f"{path}: {warning}")
        if recording.partial:
            self.partial.append(f"{path}: {recording.partial}")
            self._job.screen.warn(f"{path}: only partly read: {recording.partial}")


def exit_code(*, untrusted: bool, partial: Sequence[str]) -> int:
    """Return the exit code of a command that has written its result."""
    if untrusted:
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if partial else EXIT_DONE
