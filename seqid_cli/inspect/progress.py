"""Progress of a function over its logs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from seqid_cli.params.results.inspection import InspectionFinding


@dataclass(frozen=True)
class LogNote:
    """A log that was read: its size, warnings and findings."""

    path: Path
    sha256: str
    samples: int
    rate_hz: float
    warnings: tuple[str, ...]
    partial: str
    findings: tuple[InspectionFinding, ...] = ()
    mended: tuple[str, ...] = ()


@dataclass(frozen=True)
class Progress:
    """Progress of a function, reported before a log is read and after it was worked on.

    `done` of `total` logs are finished. `state` is "reading" (`log` comes next), "done" (`note` is
    what was read), "failed" (`error` says why `log` is left out), or "note" and "detail" (`text`
    says what the function is about).
    """

    state: Literal["reading", "done", "failed", "note", "detail"]
    done: int = 0
    total: int = 0
    log: str = ""
    note: LogNote | None = None
    error: Exception | None = None
    text: str = ""
