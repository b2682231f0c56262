"""The way that every command on logs goes: cheap checks first, then reading with an account."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from seqid_cli.commands.options import TimeSource
from seqid_cli.commands.progress import ProgressLine
from seqid_cli.commands.render import Screen
from seqid_cli.errors import ConfigError, InputError
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.logs.storage.remote import StoredLog
from seqid_cli.params.document import join, present
from seqid_cli.params.files import check_output
from seqid_cli.params.io import check_robot, read_parameters
from seqid_cli.params.schema import InputLog, ParameterFile, Stages, Verdict
from seqid_cli.robot.file import load_robot
from seqid_cli.scale.options import Workers

if TYPE_CHECKING:
    from seqid_cli.identify.parts import PartOf
    from seqid_cli.inspect.report import Finding
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.types import Robot
    from seqid_cli.scale.work import LogNote, Task

P = TypeVar("P")

ONE_PROCESS = Workers()
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

    `files` are the logs, `previous` the joined parameter files (None where none was given),
    `missing` says which arguments stand for no log, where that is no reason to stop.
    """

    screen: Screen
    files: tuple[Path, ...]
    robot: Robot
    previous: ParameterFile | None
    parameters: tuple[Path, ...]
    output: Path | None
    time_source: TimeSource
    workers: Workers = ONE_PROCESS
    missing: tuple[str, ...] = ()

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
    workers: Workers = ONE_PROCESS,
) -> Job:
    """Check all that can be checked before numpy is imported.

    `needs` names the stages that `parameters` must hold.

    Raises
    ------
    SeqidError
        A path, the robot file or a parameter file is wrong.
    """
    workers.check()
    files, missing = _logs(screen, logs, go_on=workers.skip_failed)
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
    given = (screen, tuple(files), loaded, previous, tuple(parameters), output, time_source)
    return Job(*given, workers=workers, missing=tuple(missing))


def _logs(screen: Screen, arguments: Sequence[str], *, go_on: bool) -> tuple[list[Path], list[str]]:
    """Return the logs that are meant, and what stands for none where that is no reason to stop."""
    if not go_on:
        files = expand(arguments, screen.warn, stored=True)
        for file in files:
            if not isinstance(file, StoredLog):  # listed by its store, looked into when read
                check_log(file)
        return files, []
    found, missing = [], []
    for argument in arguments:
        try:
            expand([argument], stored=True)
            found.append(argument)
        except InputError as error:
            missing.append(error)
            screen.warn(f"left out: {error}")
    if not found:
        raise missing[0]
    return expand(found, screen.warn, stored=True), [str(error) for error in missing]


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
    """Passes recordings on, or what is made of them elsewhere, and keeps account of them.

    Iterate over it once, or have it `reduced` or `mapped` once (see `identify.parts`); `inputs`,
    `partial` and `left_out` are complete afterwards. Health warnings go to the screen as they come.
    """

    def __init__(self, job: Job, *, imus: bool | None = None) -> None:
        """Take a job; `imus` says whether IMUs are read, else the IMU stage does."""
        self._job = job
        self._imus = job.stages.imu is not None if imus is None else imus
        self.findings: list[Finding] = []
        self._progress = ProgressLine(len(job.files), sys.stderr, enabled=not job.screen.quiet)
        self._logs: list[tuple[str, str, int]] = []
        self.partial: list[str] = []
        self.left_out = list(job.missing)
        self.before: Callable[[Recording], None] | None = None

    def __iter__(self) -> Iterator[Recording]:
        """Read the logs one after the other."""
        from seqid_cli.inspect.screening import read_screened
        from seqid_cli.scale.work import note_of

        job = self._job
        try:
            self._progress.show(0, job.files[0].name)
            for path in job.files:
                clock = job.time_source
                found = read_screened(path, job.robot, time_source=clock, imus=self._imus)
                recording = found.recording
                self.done(replace(note_of(recording), findings=found.findings))
                self.begun(recording)
                yield recording
                self._progress.show(len(self._logs), recording.path.name)
        finally:
            self._progress.clear()

    def reduced(self, part: PartOf[Any, P], merge: Callable[[P, P], P]) -> P | None:
        """Merge the parts of all logs, made by the job's workers."""
        from seqid_cli.scale.run import reduced_logs

        job = self._job
        try:
            self._progress.show(0, job.files[0].name)
            task = self._task(part)
            return reduced_logs(task, job.files, merge, workers=job.workers, listener=self)
        finally:
            self._progress.clear()

    def mapped(self, part: PartOf[Any, P]) -> Iterator[P]:
        """Yield the parts of all logs in their order, made by the job's workers."""
        from seqid_cli.scale.run import mapped_logs

        job = self._job
        try:
            self._progress.show(0, job.files[0].name)
            task = self._task(part)
            yield from mapped_logs(task, job.files, workers=job.workers, listener=self)
        finally:
            self._progress.clear()

    def _task(self, part: PartOf[Any, P]) -> Task[P]:
        from seqid_cli.scale.work import Task

        return Task(self._job.robot, self._job.time_source, part, Path.cwd(), self._imus)

    def inputs(self, stage: str = "") -> list[InputLog]:
        """Return the logs read so far, as documents list them."""
        return [
            InputLog(path=path, sha256=sha256, samples=samples, stage=stage)
            for path, sha256, samples in self._logs
        ]

    def begun(self, recording: Recording) -> None:
        """Hear of a recording that this process is about to work on."""
        if self.before is not None:
            self._progress.clear()
            self.before(recording)

    def done(self, note: LogNote) -> None:
        """Take account of a log that was read."""
        self._progress.clear()
        path, screen = str(note.path), self._job.screen
        self._logs.append((path, note.sha256, note.samples))
        screen.detail(f"{path}: {note.samples} samples at {note.rate_hz:.6g} Hz")
        self._found(note)
        known = {finding.message for finding in note.findings}
        for warning in note.warnings:
            if warning not in known:
                screen.warn(f"{path}: {warning}")
        screen.knows(f"{path}: {text}" for text in note.mended)
        if note.partial:
            self.partial.append(f"{path}: {note.partial}")
            screen.warn(f"{path}: only partly read: {note.partial}")
        self._show_progress(note.path)

    def _found(self, note: LogNote) -> None:
        """Take account of what is wrong with a log, and say what cannot wait for the result."""
        from seqid_cli.identify.log_verdicts import said

        for finding in note.findings:
            self.findings.append(finding)
            if finding.severity == "error":
                about = " ".join(part for part in (finding.joint, finding.channel) if part)
                text = f"{about}: {finding.message}" if about else finding.message
                self._job.screen.warn(f"{note.path}: [{finding.code}] {text}")
            elif finding.message in note.warnings:
                self._job.screen.warn(said(finding))

    def failed(self, path: Path, error: Exception) -> None:
        """Take account of a log that was left out because the user wants to go on."""
        self._progress.clear()
        text = str(error) if str(path) in str(error) else f"{path}: {error}"
        self.left_out.append(text)
        self._job.screen.warn(f"left out: {text}")
        self._show_progress(path)

    def _show_progress(self, path: Path) -> None:
        self._progress.show(len(self._logs) + len(self.left_out), path.name)

    @property
    def incomplete(self) -> list[str]:
        """What was read in part or not at all."""
        return self.partial + self.left_out

    def notes(self, known: Sequence[str] = ()) -> list[str]:
        """Return what the result must say of its logs, but for what it says already (`known`)."""
        from seqid_cli.identify.log_verdicts import notes_of_logs

        return [
            *(f"left out: {text}" for text in self.left_out),
            *notes_of_logs(self.findings, known),
        ]

    def verdicts(self) -> list[Verdict]:
        """Return a poor verdict for each error of the logs."""
        from seqid_cli.identify.log_verdicts import verdicts_of_logs

        return verdicts_of_logs(self.findings)


def exit_code(*, untrusted: bool, partial: Sequence[str]) -> int:
    """Return the exit code of a command that has written its result."""
    if untrusted:
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if partial else EXIT_DONE
