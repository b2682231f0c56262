"""Which files are meant, and whether they can be logs at all.

Runs before any heavy import, so that a wrong path fails at once: standard library only.
"""

from __future__ import annotations

import difflib
import glob
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from seqid_cli.errors import InputError

SUFFIXES = (".parquet", ".mcap")
MAGIC = {"mcap": b"\x89MCAP0\r\n", "parquet": b"PAR1"}

_OTHER_MAGIC = {
    b"#ROSBAG": (
        "a ROS 1 bag",
        "Convert it: `rosbags-convert --src FILE --dst FOLDER --dst-storage mcap`.",
    ),
    b"SQLite format 3": (
        "an SQLite file, probably a ROS 2 bag",
        "Convert the bag to MCAP with `ros2 bag convert`.",
    ),
    b"PARE": ("an encrypted Parquet file", "Write it without encryption."),
    b"\x89HDF": ("an HDF5 file", "Save the channels as Parquet."),
    b"PK\x03\x04": ("a ZIP or NumPy archive", "Unpack it, or save the channels as Parquet."),
    b"\x28\xb5\x2f\xfd": ("compressed with zstd", "Unpack it: `zstd -d FILE`."),
    b"\x1f\x8b": ("compressed with gzip", "Unpack it: `gunzip FILE`."),
    b"version https://git-lfs": ("a Git LFS pointer, not the file", "Run `git lfs pull`."),
}
_HEAD = 32


def expand(paths: Sequence[str]) -> list[Path]:
    """Turn files, folders and globs into log files.

    Parameters
    ----------
    paths : sequence of str
        Files (taken whatever their suffix), folders (searched for *.parquet and *.mcap at any
        depth, hidden files left out) and globs (`**` for any depth).

    Returns
    -------
    list of Path
        In the order of the arguments, within each in natural order (`run2` before `run10`);
        a file that is meant twice comes once.

    Raises
    ------
    InputError
        An argument stands for no file at all.
    """
    found: dict[Path, Path] = {}
    for argument in paths:
        try:
            matches = _matches(str(argument))
        except OSError as error:
            raise InputError(f"cannot be looked up ({error})", where=str(argument)) from error
        for path in matches:
            found.setdefault(path.resolve(), path)
    return list(found.values())


def check_log(path: Path) -> str:
    """Tell the format of a log by its first bytes.

    Returns
    -------
    str
        "parquet" or "mcap".

    Raises
    ------
    InputError
        The file is missing, unreadable, empty, cut short or of another kind.
    """
    where = str(path)
    try:
        if path.is_dir():
            raise InputError(
                "is a folder, not a log", hint="Name the files in it or use a glob.", where=where
            )
        with path.open("rb") as file:
            head = file.read(_HEAD)
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - 4))
            tail = file.read(4)
    except FileNotFoundError as error:
        raise InputError("does not exist", hint=_nearby(path), where=where) from error
    except PermissionError as error:
        raise InputError("may not be read", hint="Check its permissions.", where=where) from error
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be opened ({error})", where=where) from error
    if not size:
        raise InputError("is empty (0 bytes)", hint="Record or copy it again.", where=where)
    return _format(head, tail, size, where)


def _format(head: bytes, tail: bytes, size: int, where: str) -> str:
    for name, magic in MAGIC.items():
        if head.startswith(magic):
            if name == "parquet" and (tail != magic or size < 12):
                raise InputError(
                    f"the Parquet file is cut short or damaged: its footer is missing ({size} "
                    "bytes)",
                    hint="Parquet keeps its index at the end, so nothing can be salvaged: "
                    "copy it again from the source or record again.",
                    where=where,
                )
            return name
    for magic, (kind, remedy) in _OTHER_MAGIC.items():
        if head.startswith(magic):
            raise InputError(f"is {kind}; logs are Parquet or MCAP", hint=remedy, where=where)
    raise InputError(
        f"is neither Parquet nor MCAP (it starts with {head[:8]!r})",
        hint="Logs are told by their content, not by their suffix: convert it to one of the two.",
        where=where,
    )


def _matches(argument: str) -> list[Path]:
    path = Path(argument)
    if path.is_dir():
        found = _logs_in(path)
        if not found:
            raise InputError(
                "there is no *.parquet and no *.mcap in this folder",
                hint="Name the folder that holds the logs.",
                where=argument,
            )
        return found
    if path.exists() or not glob.has_magic(argument):
        if not path.exists():
            raise InputError("does not exist", hint=_nearby(path), where=argument)
        return [path]
    found = _globbed(argument)
    if not found:
        raise InputError(
            "this pattern matches no file", hint="Check the folder and the suffix.", where=argument
        )
    return found


def _globbed(pattern: str) -> list[Path]:
    found: list[Path] = []
    names = glob.glob(pattern, recursive=True)  # noqa: PTH207 (patterns may be absolute)
    for path in natural_order(Path(name) for name in names):
        # A pattern such as logs/** also matches folders and files that are no logs.
        found += _logs_in(path) if path.is_dir() and "**" not in pattern else []
        found += [path] if path.is_file() else []
    logs = [path for path in found if path.suffix.lower() in SUFFIXES]
    return logs or found


def _logs_in(folder: Path) -> list[Path]:
    return natural_order(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()
    )


def natural_order(paths: Iterable[Path]) -> list[Path]:
    """Sort paths so that numbers in names count as numbers."""
    return sorted(paths, key=lambda path: (_natural_key(str(path)), str(path)))


def _natural_key(text: str) -> list[tuple[int, int, str]]:
    parts = re.split(r"([0-9]+)", text)
    return [(0, int(part), "") if i % 2 else (1, 0, part) for i, part in enumerate(parts)]


def _nearby(path: Path) -> str:
    try:
        names = os.listdir(path.parent)  # noqa: PTH208 (a missing folder must raise here)
    except (OSError, ValueError):
        return f"The folder {path.parent} does not exist either."
    close = difflib.get_close_matches(path.name, names, n=3)
    return f"Did you mean {', '.join(close)}?" if close else "Check the path."
