"""What a function reports while it works."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from seqid_cli.params.results.inspection import InspectionFinding


@dataclass(frozen=True, kw_only=True)
class LogNote:
    """A log that was read: its size, warnings and findings.

    `partial` says why it could be read in part only; empty where it was read whole.
    `mended` says what was put right. `stamps_s` are the first and the last stamp [s].
    """

    path: Path
    sha256: str
    samples: int
    rate_hz: float
    warnings: tuple[str, ...]
    partial: str
    findings: tuple[InspectionFinding, ...] = ()
    mended: tuple[str, ...] = ()
    stamps_s: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a function: of its logs, and of a search.

    Of logs it is reported before one is read and after it was worked on.

    `done` logs of `total` are worked on. `log` is the one that comes next, is done or
    has failed. `note` says of "done" what was read, `error` of "failed" why the log is
    left out, `text` of "note" and "detail" what the function is doing. Of a "step" of a
    search, `text` is what begins, and `done` and `total` count parts of it instead of
    logs.
    """

    state: Literal["reading", "done", "failed", "note", "detail", "step"]
    done: int = 0
    total: int = 0
    log: str = ""
    note: LogNote | None = None
    error: Exception | None = None
    text: str = ""
