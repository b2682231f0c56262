"""Which logs are fitted, which are held out, and where those of earlier stages are."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from seqid_cli.discover.excerpts import Excerpts, by_digest, take_excerpts
from seqid_cli.errors import SeqidError, UsageError
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.given import Logs, expanded, listed
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.files import check_log
from seqid_cli.logs.storage.remote import TableLog
from seqid_cli.params.schema import InputLog

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
    held_out: Iterable[tuple[object, Path | Recording]], fitted: Mapping[Any, Path | Recording]
) -> None:
    """Raise UsageError if a held-out log was fitted; both by their places, or by SHA-256."""
    for own, file in held_out:
        if own in fitted:
            both = [str(x if isinstance(x, Path) else x.path) for x in (file, fitted[own])]
            where = both[0] if both[0] == both[1] else f"{both[0]} ({both[1]})"
            hint = "A held-out log must never be fitted: leave it out of one of the lists."
            raise UsageError("is given both to fit and to hold out", where=where, hint=hint)


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

    A relative path of `inputs` is tried from the working directory and then from each of `folders`,
    those of the parameter files. `at_hand` are logs that were given to be fitted, wherever earlier
    stages had them from; `held_out` those that are never to be fitted, and are not opened.
    """
    unseen = {path.resolve() for path in held_out}
    known = [log for log in inputs if unseen & {p.resolve() for p in _places(log, folders)}]
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
    for path in _places(log, folders):  # the name comes from a file: nothing else is opened
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


# Stages that need their logs as they are: moves of one joint, of which a piece may hold half.
TRIALS = ("friction", "gravity", "imu")
# Samples times joints of those that are held beside what is fitted: 50 bytes each, so 0.4 GiB.
MOST_OF_TRIALS = 8_000_000


def read_earlier(
    inputs: Inputs, found: EarlierLogs, fitted: Excerpts, options: InertiaOptions
) -> tuple[dict[str, list[Recording]], list[str]]:
    """Read the logs of earlier stages, or as much as memory bears, by stage; what is to be said."""
    at_hand = by_digest(fitted.recordings)  # not read a second time
    held = {sha256 for sha256, some in at_hand.items() if some[0].whole is None}
    trials = {sha256 for stage in TRIALS for sha256 in found.by_stage.get(stage, ())}
    needed = {x: path for x, path in found.paths.items() if x in trials and x not in held}
    others = {x: path for x, path in found.paths.items() if x not in trials and x not in at_hand}
    notes = []
    if inputs.robot.n * sum(map(likely_rows, needed.values())) > MOST_OF_TRIALS:
        notes.append(
            f"the {len(needed)} logs of earlier stages are too long to be held together;"
            " the model is fitted again without them"
        )
        needed = {}
    whole = {x.sha256: [x] for x in _logs(inputs, needed.values())} if needed else {}
    pieces = dict(at_hand)
    if others:
        given = _logs(inputs, others.values()), inputs.robot, inputs.stages
        pieces |= by_digest(take_excerpts(*given, options=options, places=False).recordings)
    by_stage = dict[str, list[Recording]]()
    for stage, logs in found.by_stage.items():
        by_stage[stage] = own = []
        for sha256 in logs:
            # Trials are taken as a whole, of others what is fitted of them.
            parts = [] if stage in TRIALS and sha256 not in held else pieces.get(sha256, [])
            own += parts or whole.get(sha256, [])
    return by_stage, notes


def _logs(inputs: Inputs, paths: Iterable[Path]) -> LogSet:
    return LogSet.of(replace(inputs, logs=tuple(paths), missing=()))
