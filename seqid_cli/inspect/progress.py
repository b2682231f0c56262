"""What a function says of each log while it works."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from seqid_cli.params.results.inspection import InspectionFinding


@dataclass(frozen=True)
class LogNote:
    """A log that was read: its size, first and last stamp [s], warnings and findings."""

    path: Path
    sha256: str
    samples: int
    rate_hz: float
    warnings: tuple[str, ...]
    partial: str
    findings: tuple[InspectionFinding, ...] = ()
    mended: tuple[str, ...] = ()
    stamps_s: tuple[float, float] | None = None


@dataclass(frozen=True)
class Progress:
    """Progress of a function, reported before a log is read and after it was worked on."""

    state: Literal["reading", "done", "failed", "note", "detail"]
    done: int = 0  # of `total` logs
    total: int = 0
    log: str = ""  # that comes next, is done or has failed
    note: LogNote | None = None  # what was read, of "done"
    error: Exception | None = None  # why it is left out, of "failed"
    text: str = ""  # of "note" and "detail": what the function is about
