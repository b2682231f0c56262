"""Files of one recording that hold one quantity each: positions.csv, torques.csv.

Their names differ in the word for the quantity alone: `run1_q.csv` and `run1_tau.csv`.
The file of the positions stands for the recording. Imports neither numpy nor Arrow
where files are text.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from seqid_cli.errors import InputError
from seqid_cli.logs.tables.csv_form import read_form
from seqid_cli.logs.tables.name_words import COMMANDED, WORDS, words_of
from seqid_cli.robot.toml_schema import Quantity

SUFFIXES = (".csv", ".tsv", ".txt", ".parquet")
_MOST_FILES = 10_000  # of a folder that are looked through
_QUANTITY = {word: quantity for quantity, words in WORDS.items() for word in words}


class Named(NamedTuple):
    """What the name of a file tells of it."""

    quantity: str
    recording: str  # the name, a star in place of the quantity


def named(path: Path) -> Named | None:
    """Return the quantity in a file's name; None where none or several are told."""
    if path.suffix.lower() not in SUFFIXES:
        return None
    parts = re.split(r"([^A-Za-z]+)", path.stem)
    words = [part.lower() for part in parts]
    found = [k for k, word in enumerate(words) if word in _QUANTITY]
    if len(found) != 1 or COMMANDED.intersection(words):
        return None
    (place,) = found
    parts[place] = "*"
    return Named(_QUANTITY[words[place]], "".join(parts) + path.suffix.lower())


def siblings(
    path: Path, files: Mapping[Quantity, str] | None = None
) -> dict[str, Path]:
    """Return the files beside one of positions that hold the other quantities.

    Parameters
    ----------
    path : Path
        The file of the positions.
    files : mapping of quantity to str, optional
        Names of the files by quantity, as the robot file declares them; by their own
        names without it.
    """
    if files:
        return {quantity: path.parent / name for quantity, name in files.items()}
    own = named(path)
    if own is None or own.quantity != "position":
        return {}
    by_quantity: dict[str, list[Path]] = {}
    for other in _beside(path):
        told = named(other)
        is_sibling = told is not None and told.recording == own.recording
        if told is not None and is_sibling and other != path:
            by_quantity.setdefault(told.quantity, []).append(other)
    found = {
        quantity: paths[0]
        for quantity, paths in by_quantity.items()
        if len(paths) == 1 and quantity != "position"
    }
    return _by_content(path, found) if found else {}


def _by_content(path: Path, found: Mapping[str, Path]) -> dict[str, Path]:
    """Return the files without those that are a log of their own.

    There are none where the positions' file has other quantities as well.
    """
    names = _column_names(path)
    if not _quantities(names) <= {"position"}:
        return {}
    others = {}
    for quantity, other in found.items():
        other_names = _column_names(other)
        is_log = "position" in _quantities(other_names) and other_names != names
        if other_names and not is_log:
            others[quantity] = other
    return others


def _quantities(names: Iterable[str]) -> set[str]:
    """Return the quantities that words in names of columns tell."""
    words = {word for name in names for word in words_of(name)}
    return {_QUANTITY[word] for word in words if word in _QUANTITY}


def _column_names(path: Path) -> tuple[str, ...]:
    """Return the names of a table's columns; empty where it is none."""
    with suppress(InputError):
        if path.suffix.lower() != ".parquet":
            return read_form(path).names
        from seqid_cli.logs.tables.parquet import list_columns

        return list_columns(path)
    return ()


def _beside(path: Path) -> Sequence[Path]:
    """Return the files in the folder of another, in order."""
    with suppress(OSError):
        entries = sorted(path.parent.iterdir())
        return [entry for entry in entries[:_MOST_FILES] if entry.is_file()]
    return ()


def without_siblings(paths: Iterable[Path]) -> tuple[list[Path], dict[Path, Path]]:
    """Part files into those that stand for a recording, and the others of these.

    Returns
    -------
    list of Path
        In their order.
    dict of Path to Path
        The file of the positions by each file that is read with it.
    """
    paths = list(paths)
    leads: dict[tuple[Path, str], Path] = {}
    for path in paths:
        told = named(path)
        if told is not None and told.quantity == "position":
            leads.setdefault((path.parent, told.recording), path)
    lead_of: dict[Path, Path] = {}
    for path in paths:
        told = named(path)
        lead = leads.get((path.parent, told.recording)) if told is not None else None
        if lead is not None and path in siblings(lead).values():
            lead_of[path] = lead
    return [path for path in paths if path not in lead_of], lead_of
