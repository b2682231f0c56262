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
WITHOUT_LOST = (
    "the model is fitted again without them, and of friction, gravity and inertia that"
    " were identified one by one what lacks any moves as the logs to fit say"
)
KNOWN = "held out, although the model that came in was identified from it"
_NAMED = 3  # logs that a note names


def held_out_logs(logs: Logs, held_out: Logs) -> tuple[Path | Recording, ...]:
    """Return the held-out logs; only their places are looked at until all is decided.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Logs to fit.
    held_out : path, table, recording, or a sequence of them
        Logs to hold out.

    Raises
    ------
    UsageError
        A log is in both lists.
    InputError
        A path stands for no log.
    """
    held_out_files = tuple(expanded(listed(held_out)))
    fitted = {_place(log): log for log in expanded(listed(logs))}
    check_unseen([(_place(log), log) for log in held_out_files], fitted)
    return held_out_files


def _place(log: Path | Recording) -> object:
    """Return what tells logs apart: a file's place, the very table or recording."""
    if isinstance(log, TableLog):
        return id(log.content)
    return log.resolve() if isinstance(log, Path) else id(log)


def check_unseen(
    held_out: Iterable[tuple[object, Path | Recording]],
    fitted: Mapping[Any, Path | Recording],
) -> None:
    """Refuse held-out logs that are fitted.

    Parameters
    ----------
    held_out : iterable of (object, Path or Recording)
        Each with its place or its SHA-256.
    fitted : mapping of object to Path or Recording
        By the same.

    Raises
    ------
    UsageError
        A log is in both.
    """
    for place, log in held_out:
        if place not in fitted:
            continue
        name = _name(log)
        fitted_name = _name(fitted[place])
        where = name if name == fitted_name else f"{name} ({fitted_name})"
        hint = "A held-out log must never be fitted: leave it out of one of the lists."
        raise UsageError("is given both to fit and to hold out", where=where, hint=hint)


def _name(log: Path | Recording) -> str:
    return str(log if isinstance(log, Path) else log.path)


@dataclass(frozen=True)
class EarlierLogs:
    """Logs that earlier stages were identified from, as far as they are still there.

    Attributes
    ----------
    paths : mapping of str to Path
        By SHA-256, where a log is now.
    by_stage : mapping of str to sequence of str
        SHA-256 of each stage's logs.
    incomplete : frozenset of str
        Stages of which a log is missing, or must not be fitted.
    notes : tuple of str
        Which logs are missing, or must not be fitted.
    """

    paths: Mapping[str, Path]
    by_stage: Mapping[str, Sequence[str]]
    incomplete: frozenset[str]
    notes: tuple[str, ...]


def find_earlier(
    inputs: Sequence[InputLog],
    folders: Sequence[Path],
    *,
    at_hand: Mapping[str, Path],
    held_out: Sequence[Path],
) -> EarlierLogs:
    """Look for the logs of earlier stages, unchanged, where the file says they are.

    Parameters
    ----------
    inputs : sequence of InputLog
        Logs of the parameter file. A relative path is tried from the working directory
        and then from each of `folders`.
    folders : sequence of Path
        Those of the parameter files.
    at_hand : mapping of str to Path
        By SHA-256, logs that were given to be fitted, wherever earlier stages had them
        from.
    held_out : sequence of Path
        Logs that are never to be fitted; they are not opened.
    """
    held_out_places = {path.resolve() for path in held_out}
    paths: dict[str, Path] = {}
    by_stage: dict[str, list[str]] = {}
    incomplete: set[str] = set()
    lost: list[str] = []
    held_out_inputs: list[str] = []
    for log in inputs:
        places = {path.resolve() for path in _places(log, folders)}
        if held_out_places & places:
            held_out_inputs.append(log.path)
            incomplete.add(log.stage)
            continue
        if log.stage not in FITTED_STAGES:
            continue
        path = paths.get(log.sha256) or at_hand.get(log.sha256) or _find(log, folders)
        if path is None:
            lost.append(log.path)
            incomplete.add(log.stage)
        else:
            paths[log.sha256] = path
            by_stage.setdefault(log.stage, []).append(log.sha256)
    notes = (
        *_note(lost, LOST, WITHOUT_LOST),
        *_note(held_out_inputs, KNOWN, "the error before is too small"),
    )
    return EarlierLogs(
        paths=paths,
        by_stage=by_stage,
        incomplete=frozenset(incomplete),
        notes=notes,
    )


def _places(log: InputLog, folders: Sequence[Path]) -> list[Path]:
    """Return where a log of a parameter file may be; nothing for what is no path."""
    places = (Path(log.path), *(folder / log.path for folder in folders))
    with contextlib.suppress(OSError, ValueError):
        return [path for path in places if path.is_file()]
    return []


def _find(log: InputLog, folders: Sequence[Path]) -> Path | None:
    """Return where a log of a parameter file is, with the same content."""
    # The name comes from a file: nothing but a log is opened.
    for path in _places(log, folders):
        with contextlib.suppress(SeqidError, OSError):
            check_log(path)
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() == log.sha256:
                    return path
    return None


def _note(paths: Sequence[str], fact: str, consequence: str) -> tuple[str, ...]:
    """Return a note that names some logs; none without a log."""
    names = list(dict.fromkeys(paths))  # a log may belong to two stages
    if not names:
        return ()
    n_more = len(names) - _NAMED
    listed_names = ", ".join(names[:_NAMED])
    if n_more > 0:
        listed_names += f" and {n_more} more"
    return (f"{fact}: {listed_names}; {consequence}",)
