"""What a caller gives as logs: paths, folders, globs, URLs, tables, recordings; one or several."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from seqid_cli.errors import SeqidWarning
from seqid_cli.logs.storage.files import expand
from seqid_cli.logs.storage.remote import TableLog

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording


class ArrowTable(Protocol):
    """A table in memory: a `pyarrow.Table`, a `pandas.DataFrame` or any other Arrow table."""

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Give the table away as an Arrow stream."""


PathLike: TypeAlias = "str | os.PathLike[str]"
Paths: TypeAlias = "PathLike | Sequence[PathLike]"
Log: TypeAlias = "PathLike | Recording | ArrowTable"
Logs: TypeAlias = "Log | Sequence[Log]"


def listed(given: Any) -> list[Any]:
    """One thing or several, as a list; a table is one thing."""
    return list(given) if isinstance(given, list | tuple) else [given]


def optional(path: PathLike | None) -> Path | None:
    """Return a path as such where there is one."""
    return None if path is None else Path(path)


def warn(message: str) -> None:
    """Say what may be wrong, as Python does."""
    warnings.warn(message, SeqidWarning, stacklevel=3)


def expanded(given: Sequence[Log], *, stored: bool = False) -> list[Path | Recording]:
    """Turn files, folders, globs and tables into logs; warns of what is left out; see `expand`."""
    found: list[Path | Recording] = []
    for is_path, group in groupby(given, key=is_place):
        if is_path:
            found += expand([os.fspath(log) for log in group], warn, stored=stored)  # type: ignore[arg-type]
        else:
            for log in group:  # a recording as it is, a table in the place of a path
                if not (hasattr(log, "health") and hasattr(log, "tau")):
                    log = TableLog.of(log, f"table_{len(found) + 1}")
                found.append(log)  # type: ignore[arg-type]
    return found


def is_place(log: Any) -> bool:
    """Whether a log is given by its place, and not itself."""
    return isinstance(log, str | os.PathLike)
