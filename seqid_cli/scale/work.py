"""What is done with one log, wherever it is done, and what comes back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, cast, runtime_checkable

from seqid_cli.logs.storage.remote import local_copy

if TYPE_CHECKING:
    from seqid_cli.inspect.report import Finding
    from seqid_cli.logs.raw import TimeSource
    from seqid_cli.logs.recording import Recording
    from seqid_cli.motion.blocks import SurveyedLog
    from seqid_cli.robot.types import Robot

P = TypeVar("P")


@dataclass(frozen=True)
class LogNote:
    """What a command tells of a log that was read."""

    path: Path
    sha256: str
    samples: int
    rate_hz: float
    warnings: tuple[str, ...]
    partial: str
    findings: tuple[Finding, ...] = ()
    mended: tuple[str, ...] = ()


@runtime_checkable
class LogOpener(Protocol):
    """A part that passes over some logs instead of having them read."""

    def open_log(self, path: Path, robot: Robot, time_source: TimeSource) -> SurveyedLog | None:
        """Open a log that is better passed over; None for others."""


def note_of(recording: Recording | SurveyedLog) -> LogNote:
    """Return what is to be told of a recording."""
    from seqid_cli.logs.recording import Recording

    if not isinstance(recording, Recording):
        log = recording
        return LogNote(log.path, log.sha256, log.samples, log.rate_hz, log.warnings, log.partial)
    return LogNote(
        recording.path,
        recording.sha256,
        len(recording.t),
        recording.rate_hz,
        recording.health.warnings,
        recording.partial,
        mended=recording.health.mended,
    )


class Listener(Protocol):
    """Hears of every log, in their order."""

    def begun(self, recording: Recording) -> None:
        """Hear of a recording that this very process is about to work on."""

    def done(self, note: LogNote) -> None:
        """Hear of a log that was worked on."""

    def failed(self, path: Path, error: Exception) -> None:
        """Hear of a log that was left out."""


@dataclass(frozen=True)
class Item:
    """One log and its number."""

    number: int
    path: Path

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class Done(Generic[P]):
    """What one log says, and what is to be told of it."""

    note: LogNote
    part: P


@dataclass(frozen=True)
class Task(Generic[P]):
    """Reads a log and takes its part.

    Parameters
    ----------
    robot : Robot
    time_source : {"header", "log"}
    part : callable
        From a recording and its number to what is wanted of it.
    folder : Path
        Where relative paths start; they stay as they are in results.
    imus : bool
        Whether the readings of IMUs are used, and hence checked.
    """

    robot: Robot
    time_source: TimeSource
    part: Callable[[Recording, int], P]
    folder: Path
    imus: bool = True

    def __call__(self, item: Item) -> Done[P]:
        """Work on one log.

        Raises
        ------
        SeqidError
            The log cannot be read or is of no use.
        """
        return self.work(item)

    def work(self, item: Item, listener: Listener | None = None) -> Done[P]:
        """Work on one log, of which a listener in this process hears before the long part."""
        from seqid_cli.logs.recording import Recording

        # Those that pass over a log read it again and again: a stored one's copy must last.
        with local_copy(item.path) as file:
            log, findings = self.read(file, item.path)
            if listener is not None and isinstance(log, Recording):
                listener.begun(log)
            note = replace(note_of(log), findings=findings)
            # Only a part that opened it itself is given a log that is to be passed over.
            return Done(note, self.part(cast("Recording", log), item.number))

    def read(self, file: Path, name: Path) -> tuple[Recording | SurveyedLog, tuple[Finding, ...]]:
        """Read and check one log from a file, under the name that it was given by."""
        from seqid_cli.inspect.screening import read_screened, screened_long

        away = not file.is_absolute() and self.folder != Path.cwd()
        place = self.folder / file if away else file
        opened: SurveyedLog | None = None
        if isinstance(self.part, LogOpener):
            opened = self.part.open_log(place, self.robot, self.time_source)
        if opened is None:
            held = read_screened(place, self.robot, time_source=self.time_source, imus=self.imus)
            findings = tuple(replace(finding, log=str(name)) for finding in held.findings)
            return replace(held.recording, path=name), findings
        found = screened_long(replace(opened, path=name), self.robot)
        return found.log, found.findings
