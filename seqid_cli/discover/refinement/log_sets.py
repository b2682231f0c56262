"""Which logs are fitted, which are held out, and where those of earlier stages are."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from seqid_cli.errors import SeqidError, UsageError
from seqid_cli.logs.given import Logs, expanded, listed
from seqid_cli.logs.storage.files import check_log
from seqid_cli.logs.storage.remote import TableLog
from seqid_cli.params.schema import InputLog

if TYPE_CHECKING:
    from seqid_cli.logs.recording import Recording

# Stages whose logs determine the model; "effects" are those of an earlier refinement.
FITTED_STAGES = ("friction", "gravity", "imu", "inertia", "effects")
LOST = "logs of earlier stages that are no longer there or have changed"
KNOWN = "held out, although the model that came in was identified from it"
_NAMED = 3  # logs that a note names


def held_out_logs(logs: Logs, held_out: Logs) -> tuple[Path | Recording, ...]:
    """Return the held-out logs; by its place alone each is known until all is decided.

    Raises UsageError: a log is in both lists; InputError: a path stands for no log.
    """
    files = tuple(expanded(listed(held_out)))
    fitted = {_place(file): file for file in expanded(listed(logs))}
    check_unseen([(_place(file), file) for file in files], fitted)
    return files


def _place(log: Path | Recording) -> object:
    """What tells logs from each other: the place of a file, the very table or recording."""
    if isinstance(log, TableLog):
        return id(log.content)
    return log.resolve() if isinstance(log, Path) else id(log)


def check_unseen(
    held_out: Iterable[tuple[object, Path | Recording]],
    fitted: Mapping[Any, Path | Recording],
) -> None:
    """Raise UsageError if a held-out log was fitted; both by their places, or by SHA-256."""
    for own, file in held_out:
        if own in fitted:
            both = [
                str(x if isinstance(x, Path) else x.path) for x in (file, fitted[own])
            ]
            where = both[0] if both[0] == both[1] else f"{both[0]} ({both[1]})"
            hint = (
                "A held-out log must never be fitted: leave it out of one of the lists."
            )
            raise UsageError(
                "is given both to fit and to hold out", where=where, hint=hint
            )


@dataclass(frozen=True)
class EarlierLogs:
    """Logs that the stages before were identified from, as far as they are still there."""

    paths: Mapping[str, Path]  # by SHA-256: where a log is now
    by_stage: Mapping[str, Sequence[str]]  # SHA-256 of each stage's logs
    notes: tuple[str, ...]


def find_earlier(
    inputs: Sequence[InputLog],
    folders: Sequence[Path],
    *,
    at_hand: Mapping[str, Path],
    held_out: Sequence[Path],
) -> EarlierLogs:
    """Look for the logs of earlier stages, unchanged, where the parameter file says they are.

    A relative path of `inputs` is tried from the working directory and then from each
    of `folders`, those of the parameter files. `at_hand` are logs that were given to be
    fitted, wherever earlier stages had them from; `held_out` those that are never to be
    fitted, and are not opened.
    """
    unseen = {path.resolve() for path in held_out}
    known = [
        log for log in inputs if unseen & {p.resolve() for p in _places(log, folders)}
    ]
    paths, by_stage, lost = dict[str, Path](), dict[str, list[str]](), list[str]()
    for log in (x for x in inputs if x.stage in FITTED_STAGES and x not in known):
        path = paths.get(log.sha256) or at_hand.get(log.sha256) or _find(log, folders)
        if path is None:
            lost.append(log.path)
        else:
            paths[log.sha256] = path
            by_stage.setdefault(log.stage, []).append(log.sha256)
    notes = _note(lost, LOST, "the model is fitted again without them")
    notes += _note([log.path for log in known], KNOWN, "the error before is too small")
    return EarlierLogs(paths, by_stage, notes)


def _places(log: InputLog, folders: Sequence[Path]) -> list[Path]:
    """Where a log of a parameter file may be; nothing for what is no path."""
    places = (Path(log.path), *(folder / log.path for folder in folders))
    with contextlib.suppress(OSError, ValueError):
        return [path for path in places if path.is_file()]
    return []


def _find(log: InputLog, folders: Sequence[Path]) -> Path | None:
    # the name comes from a file: nothing else is opened
    for path in _places(log, folders):
        with contextlib.suppress(SeqidError, OSError):
            check_log(path)
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() == log.sha256:
                    return path
    return None


def _note(paths: Sequence[str], before: str, after: str) -> tuple[str, ...]:
    names = list(dict.fromkeys(paths))  # a log may belong to two stages
    rest = len(names) - _NAMED
    some = ", ".join(names[:_NAMED]) + (f" and {rest} more" if rest > 0 else "")
    return (f"{before}: {some}; {after}",) if names else ()
