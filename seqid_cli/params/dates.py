"""Dates of results, by which the same inputs give the same bytes.

A result carries no time of the clock on the wall: it would differ from run to run.
`created` is SOURCE_DATE_EPOCH where that is set
(https://reproducible-builds.org/specs/source-date-epoch), else the time of the newest
input: of a log its last stamp where the stamps are dates, else when its file was last
modified; of a result its own `created`.
"""

import os
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from seqid_cli.errors import UsageError
from seqid_cli.params.schema import ParameterFile, Written

VARIABLE = "SOURCE_DATE_EPOCH"
# Stamps from 2000-01-01 to 2100-01-01 are dates. Others count from a start-up or a
# log's begin: a controller would have to run for 30 years to be taken for a calendar.
EARLIEST_DATE_S = 946_684_800.0
LATEST_DATE_S = 4_102_444_800.0
# Of the year 9999, the last that an ISO 8601 date can name.
_LAST_SECOND = 253_402_300_799


def now() -> str:
    """Return the present time in UTC in the form of documents."""
    return in_words(time.time())


def in_words(seconds: float) -> str:
    """Return a Unix time [s] as a date in UTC, to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))


def is_date(seconds: float) -> bool:
    """Return whether a stamp [s] is a date, and not counted from a start-up."""
    return EARLIEST_DATE_S <= seconds < LATEST_DATE_S


def recorded_between(first_s: float, last_s: float) -> list[str | float]:
    """Return first and last stamp [s] of a log: as dates in UTC, else as they are."""
    if is_date(first_s) and is_date(last_s):
        return [_with_fraction(first_s), _with_fraction(last_s)]
    return [round(float(first_s), 9), round(float(last_s), 9)]


def _with_fraction(seconds: float) -> str:
    """Return a Unix time [s] as a date in UTC, to the microsecond."""
    date = datetime.fromtimestamp(seconds, UTC)
    return date.isoformat(timespec="microseconds").replace("+00:00", "Z")


def modified_s(path: Path) -> float | None:
    """Return when a file was last modified [s, Unix]; None where there is none."""
    try:
        return path.stat().st_mtime
    except (OSError, ValueError):  # a table in memory, or a name that no file can have
        return None


def date_of(document: Written) -> float | None:
    """Return the `created` of a document [s, Unix]; None where it is no date."""
    try:
        when = datetime.fromisoformat(document.created)
    except ValueError:
        return None
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    return when.timestamp()


def recorded_date(file: ParameterFile) -> str:
    """Return when the newest log of a file was recorded, as a date.

    It is the file's `created` where no log has dates for stamps. The last stamp of each
    log is compared as text: all are in UTC and written to the same digits.
    """
    last_stamps = [log.recorded[-1] for log in file.inputs if log.recorded]
    dates = [stamp for stamp in last_stamps if isinstance(stamp, str)]
    return max(dates, default=file.created)


def source_date_epoch() -> int | None:
    """Return the date that the environment wants of all results [s, Unix], if any.

    Raises
    ------
    UsageError
        It is set to something else than a number of seconds.
    """
    text = os.environ.get(VARIABLE)
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and int(text) <= _LAST_SECOND):
        hint = (
            "Set it to seconds since 1970, as from: git log -1 --format=%ct; or"
            " unset it."
        )
        raise UsageError(
            f"{VARIABLE} is no number of seconds: {text[:40]!r}", hint=hint
        )
    return int(text)


def created_from(
    documents: Iterable[Written],
    log_times_s: Iterable[float] = (),
    *,
    otherwise: Path | None = None,
) -> str:
    """Return the date of a result that is made of documents and logs.

    Parameters
    ----------
    documents : iterable of Written
        Earlier results.
    log_times_s : iterable of float
        The times of the logs [s, Unix].
    otherwise : path, optional
        The file that dates the result where neither documents nor logs have a date, as
        the robot file does for a plan. Without one it is the present time.

    Raises
    ------
    UsageError
        As `source_date_epoch` does.
    """
    wanted = source_date_epoch()
    if wanted is not None:
        return in_words(wanted)

    dates = [date for date in map(date_of, documents) if date is not None]
    dates += log_times_s
    if not dates and otherwise is not None:
        modified = modified_s(otherwise)
        if modified is not None:
            dates.append(modified)
    return in_words(max(dates)) if dates else now()
