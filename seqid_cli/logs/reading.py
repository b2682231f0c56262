"""How a log is read: by which of its stamps, and which part of it.

Standard library only: options are checked before anything heavy is imported.

A moment is in seconds from the log's first sample, or a stamp: a date such as
2026-03-01T12:00:00Z, a number of seconds since 1970, or `@` and a number of seconds of
the log's own clock.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal

from seqid_cli.errors import UsageError

TimeSource = Literal["header", "log"]
# A number from here on is a stamp [s since 1970]: no log is three years long.
STAMPS_FROM_S = 1e8
_NUMBER = r"[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?"
_RANGE = re.compile(r"\s*(?P<start>[^,]+?)\s*(?:,|\.\.)\s*(?P<stop>[^,]+?)\s*")
_SHORT_RANGE = re.compile(rf"\s*(?P<start>{_NUMBER})\s*[:-]\s*(?P<stop>{_NUMBER})\s*")
_HINT = (
    "Give seconds from the log's start, such as 12.5, or a stamp:"
    " 2026-03-01T12:00:00Z, seconds since 1970, or @ and seconds of the log's clock."
)


@dataclass(frozen=True)
class Moment:
    """A moment of a log: seconds from its first sample, or of its clock."""

    seconds: float
    is_stamp: bool = False

    @classmethod
    def of(cls, given: "str | float", option: str) -> "Moment":
        """Read a moment; raises UsageError, naming the option, for another text."""
        text = str(given).strip()
        try:
            is_stamp = text.startswith("@")
            seconds = float(text.removeprefix("@"))
        except ValueError:
            try:
                date = datetime.fromisoformat(text)
            except ValueError:
                raise UsageError(
                    f"{option} {text[:60]!r} is no moment of a log", hint=_HINT
                ) from None
            is_stamp = True
            zoned = date if date.tzinfo is not None else date.replace(tzinfo=UTC)
            seconds = zoned.timestamp()
        if not math.isfinite(seconds) or (seconds < 0.0 and not is_stamp):
            raise UsageError(
                f"{option} {text[:60]!r} is no moment of a log", hint=_HINT
            )
        return cls(seconds, is_stamp or seconds >= STAMPS_FROM_S)

    def __str__(self) -> str:
        return f"{'@' if self.is_stamp else ''}{self.seconds!r}"

    def ns(self, first_ns: int) -> int:
        """Return its stamp [ns] in a log whose first sample has another one."""
        seconds_ns = round(self.seconds * 1e9)
        return seconds_ns if self.is_stamp else first_ns + seconds_ns


@dataclass(frozen=True, kw_only=True)
class LogPart:
    """The part of each log that is used; all of it without arguments.

    Attributes
    ----------
    start, stop : Moment or None
        What lies before and behind is left out.
    excluded : tuple of (Moment, Moment)
        What lies between them is left out as well.
    """

    start: Moment | None = None
    stop: Moment | None = None
    excluded: tuple[tuple[Moment, Moment], ...] = ()

    @classmethod
    def of(
        cls,
        start: "str | float | None" = None,
        stop: "str | float | None" = None,
        exclude: "Sequence[str | tuple[str | float, str | float]] | None" = None,
    ) -> "LogPart":
        """Read what `--from`, `--to` and `--exclude` say.

        Raises UsageError where one of them is no moment, or ends before it starts.
        """
        part = cls(
            start=None if start is None else Moment.of(start, "--from"),
            stop=None if stop is None else Moment.of(stop, "--to"),
            excluded=tuple(_range(given) for given in exclude or ()),
        )
        if part.start is not None and part.stop is not None:
            _check_order(part.start, part.stop, "--from and --to")
        return part

    def __bool__(self) -> bool:
        return self != ALL

    @property
    def words(self) -> list[str]:
        """The words of a command line that say the same."""
        words = []
        if self.start is not None:
            words += ["--from", str(self.start)]
        if self.stop is not None:
            words += ["--to", str(self.stop)]
        for start, stop in self.excluded:
            words += ["--exclude", f"{start},{stop}"]
        return words


ALL = LogPart()


def part_of_words(words: Sequence[str]) -> LogPart:
    """Return the part that words of a command line say; see `LogPart.words`.

    Raises UsageError for other words.
    """
    values: dict[str, list[str]] = {"--from": [], "--to": [], "--exclude": []}
    for option, value in zip(words[::2], words[1::2], strict=False):
        values.setdefault(option, []).append(value)
    start, stop, exclude = (values[name] for name in ("--from", "--to", "--exclude"))
    return LogPart.of(next(iter(start), None), next(iter(stop), None), exclude=exclude)


def _range(given: "str | tuple[str | float, str | float]") -> tuple[Moment, Moment]:
    """Read a range of time: `3,5`, `3..5`, or `3:5` where both are numbers."""
    if isinstance(given, str):
        match = _SHORT_RANGE.fullmatch(given) or _RANGE.fullmatch(given)
        if match is None:
            raise UsageError(
                f"--exclude {given[:60]!r} is no range of time",
                hint=f"Give its start and its end: --exclude 3,5. {_HINT}",
            )
        given = (match["start"], match["stop"])
    start, stop = (Moment.of(each, "--exclude") for each in given)
    _check_order(start, stop, "--exclude")
    return start, stop


def _check_order(start: Moment, stop: Moment, option: str) -> None:
    """Raise UsageError where a range of time is empty."""
    if start.is_stamp == stop.is_stamp and start.seconds >= stop.seconds:
        raise UsageError(
            f"{option}: {start} s is not before {stop} s",
            hint="Give the earlier moment first.",
        )


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How logs are read.

    Attributes
    ----------
    time_source : {"header", "log"}
        MCAP and bags only: the stamps in the messages, or the times of logging.
    part : LogPart
        The part of each log that is used.
    part_by_sha256 : mapping of str to LogPart
        That of logs of which an earlier stage used a part, by their content. It counts
        where `part` is all of a log.
    """

    time_source: TimeSource = "header"
    part: LogPart = ALL
    part_by_sha256: Mapping[str, LogPart] = field(default_factory=dict)

    def part_of(self, sha256: str) -> LogPart:
        """Return the part that is used of a log."""
        return self.part or self.part_by_sha256.get(sha256, self.part)


HEADER_STAMPS = Reading()
