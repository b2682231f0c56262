"""What a caller gives as logs: paths, folders, globs, URLs, tables or recordings."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, cast

from seqid_cli.errors import SeqidWarning
from seqid_cli.logs.storage.files import expand
from seqid_cli.logs.storage.remote import TableLog

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording
    from seqid_cli.typing import Array


class ArrowTable(Protocol):
    """A table in memory: `pyarrow.Table`, `pandas.DataFrame` or another Arrow table."""

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Give the table away as an Arrow stream."""


PathLike: TypeAlias = "str | os.PathLike[str]"
Paths: TypeAlias = "PathLike | Sequence[PathLike]"
Arrays: TypeAlias = "Mapping[str, Sequence[float] | Array]"
Log: TypeAlias = "PathLike | Recording | ArrowTable | Arrays"
Logs: TypeAlias = "Log | Sequence[Log]"


def listed(argument: Any) -> list[Any]:
    """Return an argument, one thing or several, as a list; a table is one thing."""
    if isinstance(argument, list | tuple):
        return list(argument)
    return [argument]


def optional(path: PathLike | None) -> Path | None:
    """Return a path, or None where none is given."""
    return None if path is None else Path(path)


def warn(message: str) -> None:
    """Warn of what may be wrong, as Python does."""
    warnings.warn(message, SeqidWarning, stacklevel=3)


def expanded(logs: Sequence[Log], *, stored: bool = False) -> list[Path | Recording]:
    """Turn files, folders, globs and tables into logs, in the order in which they come.

    Parameters
    ----------
    logs : sequence of Log
        Consecutive paths are looked up together, see `expand`; a recording stays as it
        is; a table becomes a file when it is read.
    stored : bool
        Whether URLs of object storage are welcome.
    """
    expanded_logs: list[Path | Recording] = []
    for are_places, group in groupby(logs, key=is_place):
        if are_places:
            places = [os.fspath(cast("PathLike", log)) for log in group]
            expanded_logs += expand(places, warn, stored=stored)
            continue
        for log in group:
            if _is_recording(log):
                expanded_logs.append(cast("Recording", log))
            else:
                name = f"table_{len(expanded_logs) + 1}"
                expanded_logs.append(TableLog.of(log, name))
    return expanded_logs


def is_place(log: Any) -> bool:
    """Tell whether a log is given by its place, not by its content."""
    return isinstance(log, str | os.PathLike)


def _is_recording(log: Any) -> bool:
    # By its fields: to import the class would import NumPy before a path is checked.
    return hasattr(log, "health") and hasattr(log, "tau")
