"""Which files are meant, and whether they can be logs.

Nothing heavy is imported here: a wrong path fails at once.
"""

import difflib
import glob
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from seqid_cli.being_read import being_read
from seqid_cli.errors import InputError
from seqid_cli.logs.storage.remote import StoredLog, is_url, stored_logs
from seqid_cli.logs.tables.csv_form import is_text, nameless, read_form
from seqid_cli.logs.tables.naming_schemes import stamp_parts, time_names
from seqid_cli.logs.tables.siblings import without_siblings
from seqid_cli.params.dates import is_date, modified_s

SUFFIXES = (".parquet", ".mcap", ".csv", ".tsv", ".db3", ".bag")
CSV_SUFFIXES = (".csv", ".tsv")
MAGIC = {
    "mcap": b"\x89MCAP0\r\n",
    "parquet": b"PAR1",
    "rosbag1": b"#ROSBAG V2.0",
    "rosbag2": b"SQLite format 3\0",
}
METADATA = "metadata.yaml"  # what makes a folder a ROS 2 bag

_FROM_MATLAB = (
    'Write a table in MATLAB: parquetwrite("log.parquet", array2table([t q i],'
    ' "VariableNames", ["time" "q1" "q2" "i1" "i2"])). In Python scipy.io.loadmat reads'
    " it, but for version 7.3, and a dict of arrays is a log for seqid's functions."
)
_FROM_NUMPY = (
    "Write a table in Python: numpy.savetxt('log.csv', numpy.column_stack([t, q, i]), "
    "delimiter=',', comments='', header='time,q1,q2,i1,i2')."
)
_OTHER_MAGIC = {
    b"#ROSBAG": (
        "a ROS bag of an old version",
        "Convert it: `rosbag fix OLD.bag NEW.bag`.",
    ),
    b"PARE": ("an encrypted Parquet file", "Write it without encryption."),
    b"\x89HDF": ("an HDF5 file, or MATLAB's of version 7.3", _FROM_MATLAB),
    b"MATLAB 5.0": ("a MATLAB file", _FROM_MATLAB),
    b"PK\x03\x04": ("a ZIP or NumPy archive", f"Unpack it; NumPy: {_FROM_NUMPY}"),
    b"\x93NUMPY": ("a NumPy array", _FROM_NUMPY),
    b"\x28\xb5\x2f\xfd": ("compressed with zstd", "Unpack it: `zstd -d FILE`."),
    b"\x1f\x8b": ("compressed with gzip", "Unpack it: `gunzip FILE`."),
    b"version https://git-lfs": (
        "a Git LFS pointer, not the file",
        "Run `git lfs pull`.",
    ),
}
_HEAD = 4096  # bytes that tell the format
_NEITHER = "is neither Parquet nor MCAP, no ROS bag and no CSV table"
_NAME_IT = "Name the file itself, or write *.csv, if it is a log."
# Suffixes of what lies beside logs, and of what may be a table of text.
_NOTES = (".toml", ".json", ".yaml", ".urdf", ".xml", ".md", ".py")
_TEXTS = (*CSV_SUFFIXES, ".txt", ".log", ".dat")

_SEPARATORS = tuple(filter(None, (os.sep, os.altsep)))

State = tuple[int, ...]
Stamps = tuple[float, float]
Note = Callable[[str], None]


def expand(
    paths: Sequence[str], note: Note | None = None, *, stored: bool = False
) -> list[Path]:
    """Turn files, folders and globs into log files.

    Parameters
    ----------
    paths : sequence of str
        Files (taken whatever their suffix), folders (searched at any depth for the
        suffixes of logs, hidden files left out; a ROS 2 bag is such a folder) and globs
        (`**` for any depth).
    note : callable, optional
        Told what was left out, and why.
    stored : bool
        Whether URLs of object storage are welcome as well.

    Returns
    -------
    list of Path
        Each file once, in the natural order of their paths (`run2` before `run10`), so
        that results repeat bit by bit.

    Raises
    ------
    InputError
        An argument stands for no file at all.
    """
    path_by_place: dict[Path, Path] = {}
    for argument in map(str, paths):
        if is_url(argument) and not stored:
            raise InputError(
                "is on object storage, which this command does not read",
                hint="Copy it here first.",
                where=argument,
            )
        try:
            if is_url(argument):
                matches = natural_order(stored_logs(argument, SUFFIXES))
            else:
                matches = _matches(argument, note or _ignore)
        except OSError as error:
            raise InputError(
                f"cannot be looked up ({error})", where=argument
            ) from error
        for path in matches:
            path_by_place.setdefault(path.resolve(), path)
    logs, _ = without_siblings(path_by_place.values())
    return natural_order(logs)


def _ignore(text: str) -> None:
    """Take a note that nobody asked for."""


def storage_file(path: Path) -> Path:
    """Return a file itself, or the one that holds the messages of a ROS 2 bag folder.

    Raises InputError for a folder of another kind, or a bag of several files.
    """
    if not path.is_dir():
        return path
    if not (path / METADATA).is_file():
        raise InputError(
            "is a folder, not a log",
            hint="Name the files in it or use a glob.",
            where=str(path),
        )
    files = _logs_in(path, _ignore)
    if len(files) == 1:
        return files[0]
    if files:
        raise InputError(
            f"is a ROS 2 bag of {len(files)} files",
            hint="Name its files.",
            where=str(path),
        )
    raise InputError(
        "is a ROS 2 bag without *.mcap and *.db3",
        hint="Unpack what is compressed: `zstd -d FILE`.",
        where=str(path),
    )


def sha256_of(path: Path) -> str:
    """Return the digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def time_of_log(path: Path, stamps_s: Stamps | None) -> float | None:
    """Return the time of a log [s, Unix].

    It is the last stamp where the stamps are dates, else when the file was last
    modified; None where that is not known either, as of a table in memory.

    Parameters
    ----------
    stamps_s : (float, float), optional
        First and last stamp [s, the log's own clock].
    """
    if stamps_s is not None and all(map(is_date, stamps_s)):
        return stamps_s[1]
    if isinstance(path, StoredLog):
        return path.modified_s()
    try:
        return modified_s(storage_file(path))
    except InputError:
        return None


def state_of(path: Path) -> State:
    """Return what differs when a file is another one than before."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns, status.st_ino


@contextmanager
def unchanged(path: Path, before: State | None = None) -> Iterator[None]:
    """Read a log that must not change meanwhile, or since its state `before`.

    Raises InputError where it changes, or cannot be read.
    """
    try:
        state = before or state_of(path)
        with being_read(path):
            yield
        is_same = state_of(path) == state
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    if not is_same:
        raise InputError(
            "changed while it was read",
            hint="Wait until it is recorded or copied, then run this again.",
            where=str(path),
        )


def check_log(path: Path) -> str:
    """Tell the format of a log by its first bytes.

    Returns
    -------
    str
        parquet, mcap, csv, rosbag2 (an SQLite file) or rosbag1.

    Raises
    ------
    InputError
        The file is missing, unreadable, empty, cut short or of another kind.
    """
    where = str(path)
    ends = _ends_of(path, where)
    if not ends.size:
        raise InputError(
            "is empty (0 bytes)", hint="Record or copy it again.", where=where
        )
    kind = _format(ends.head, where)
    if kind == "parquet" and (ends.tail != MAGIC[kind] or ends.size < 12):
        raise InputError(
            "the Parquet file is cut short or damaged: its footer is missing"
            f" ({ends.size} bytes)",
            hint="Parquet keeps its index at the end, so nothing can be salvaged: copy"
            " it again from the source or record again.",
            where=where,
        )
    if kind == "csv":
        try:
            read_form(ends.file)
        except InputError as error:
            if ends.file.suffix.lower() not in _TEXTS:
                error.message = f"{_NEITHER}: {error.message}"
            raise
    return kind


class _Ends(NamedTuple):
    """The first and last bytes of a file, and its size."""

    file: Path
    head: bytes
    tail: bytes
    size: int


def _ends_of(path: Path, where: str) -> _Ends:
    """Read the ends of a log's file; raises InputError where that cannot be done."""
    try:
        path = storage_file(path)
        # a pipe would be waited for without end
        if path.exists() and not path.is_file():
            raise InputError(
                "is no regular file", hint="Copy it into one first.", where=where
            )
        with path.open("rb") as file:
            head = file.read(_HEAD)
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - 4))
            return _Ends(path, head, file.read(4), size)
    except FileNotFoundError as error:
        raise InputError("does not exist", hint=_nearby(path), where=where) from error
    except PermissionError as error:
        raise InputError(
            "may not be read", hint="Check its permissions.", where=where
        ) from error
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be opened ({error})", where=where) from error


def _format(head: bytes, where: str) -> str:
    """Return the format that begins with these bytes; raises InputError if none."""
    for name, magic in MAGIC.items():
        if head.startswith(magic):
            return name
    for magic, (kind, remedy) in _OTHER_MAGIC.items():
        if head.startswith(magic):
            raise InputError(
                f"is {kind}, not a log that can be read", hint=remedy, where=where
            )
    if is_text(head) or head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "csv"
    raise InputError(
        f"{_NEITHER} (it starts with {head[:8]!r})",
        hint="Logs are told by their content, not by their suffix: convert it to one of"
        " these.",
        where=where,
    )


def _matches(argument: str, note: Note) -> list[Path]:
    """Return the logs that an argument means; raises InputError if there are none."""
    path = Path(argument)
    if path.is_dir():
        logs = _logs_in(path, note)
        if not logs:
            raise _no_logs(path)
        return logs
    if path.exists():
        return [path]
    if not glob.has_magic(argument):
        raise InputError("does not exist", hint=_nearby(path), where=argument)
    matches = _globbed(argument, note)
    if matches:
        return matches
    raise InputError(
        "this pattern matches no file",
        hint="Check the folder and the suffix.",
        where=argument,
    )


def _no_logs(folder: Path, *, looked_at: int = 20) -> InputError:
    """Make the error for a folder without logs.

    It says why the first file is none that might be one, of `looked_at` files.
    """
    patterns = ", ".join("*" + suffix for suffix in SUFFIXES)
    message = f"there is no log in this folder ({patterns})"
    hint = "Name the folder of the logs."
    files = natural_order(path for path in folder.rglob("*") if path.is_file())
    for path in files[:looked_at]:
        if path.suffix in _NOTES:
            continue
        fault = _fault_of(path)
        if fault is None:
            message += f"; {path.name} is a table of another suffix"
            hint = _NAME_IT
            break
        if not fault.reason.startswith(_NEITHER):
            message += f"; {path.name} {fault.reason}"
            hint = fault.remedy or _NAME_IT
            break
    return InputError(message, hint=hint, where=str(folder))


def _globbed(pattern: str, note: Note) -> list[Path]:
    """Return the logs that a pattern matches, or else the other files."""
    files: list[Path] = []
    for path in natural_order(map(Path, dict.fromkeys(_names(pattern)))):
        # A pattern such as logs/** also matches folders and files that are no logs.
        if path.is_dir() and "**" not in pattern:
            files += _logs_in(path, note)
        if path.is_file():
            files.append(path)

    logs = [path for path in files if path.suffix.lower() in SUFFIXES]
    if not logs:
        return files
    if pattern.lower().endswith(CSV_SUFFIXES):  # then they are named explicitly
        return logs
    return [path for path in logs if _is_meant(path, note)]


def _names(pattern: str) -> Iterator[str]:
    """Yield what matches a pattern, in which `**` stands for folders of any depth.

    The library's own `**` takes a folder with two links to itself for 2^40 folders.
    """
    before, stars, after = pattern.partition("**")
    is_component = before[-1:] in ("", *_SEPARATORS) and after[:1] in ("", *_SEPARATORS)
    if not stars or not is_component:
        yield from glob.iglob(pattern)  # noqa: PTH207 (patterns may be absolute)
        return
    rest = after.lstrip("".join(_SEPARATORS))
    # PTH207: as above.
    starts = glob.glob(before) if before else [""]  # noqa: PTH207
    for start in starts:
        for folder in _folders(start):
            if rest:
                yield from _names(str(Path(glob.escape(folder), rest)))
                continue
            if folder:
                yield folder
            yield from glob.iglob(str(Path(glob.escape(folder), "*")))  # noqa: PTH207


def _folders(start: str) -> Iterator[str]:
    """Yield a folder and the folders in it, at any depth, hidden ones left out.

    Links are followed, and each folder is met once, whatever leads to it.
    """
    met: set[tuple[int, int]] = set()
    waiting = [start]
    while waiting:
        folder = waiting.pop()
        try:
            state = os.stat(folder or ".")  # noqa: PTH116 ("" is the working folder)
            entries = sorted(os.scandir(folder or "."), key=lambda entry: entry.name)
        except OSError:
            continue  # it is gone, no folder, or closed to its reader
        place = (state.st_dev, state.st_ino)
        if place in met:
            continue
        met.add(place)
        yield folder
        waiting += [
            str(Path(folder, entry.name))
            for entry in reversed(entries)
            if entry.is_dir() and not entry.name.startswith(".")
        ]


def _logs_in(folder: Path, note: Note) -> list[Path]:
    """Return the logs in a folder, at any depth."""
    candidates = [
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in SUFFIXES
        and not path.name.startswith(".")
        and path.is_file()
        and not _describes_lerobot(path)
    ]
    # Files of one quantity each make a log, whether or not they tell the time.
    leads, lead_of = without_siblings(natural_order(candidates))
    joined = set(lead_of.values())
    return [path for path in leads if path in joined or _is_meant(path, note)]


def _describes_lerobot(path: Path) -> bool:
    """Tell whether a table belongs to the description of a LeRobot data set."""
    return any(
        folder.name == "meta" and (folder / "info.json").is_file()
        for folder in path.parents
    )


def _is_meant(path: Path, note: Note) -> bool:
    """Tell whether a file that was not named itself is a log; notes why it is none.

    A CSV file may be all sorts of things. A Parquet file is no log if it is a table of
    `predict --torques`: its torques are of logs that count already.
    """
    reason = ""
    if path.suffix.lower() == ".parquet":
        from seqid_cli.logs.tables.parquet import list_columns

        with suppress(InputError):
            endings = {name.rpartition(".")[2] for name in list_columns(path)}
            if {"predicted", "residual", "sliding"} <= endings:
                reason = "seqid predict wrote it"
    elif path.suffix.lower() in CSV_SUFFIXES:
        fault = _fault_of(path)
        if fault is not None:
            reason = f"it {fault.reason}; name the file itself if it is one"
    if reason:
        note(f"{path} is left out, it is no log: {reason}")
    return not reason


class _Fault(NamedTuple):
    """Why a file is no log, and what to do."""

    reason: str
    remedy: str


def _fault_of(path: Path) -> _Fault | None:
    """Return why a file is no log; None where it is one."""
    try:
        if check_log(path) != "csv":
            return None
        names = read_form(path).names
    except InputError as error:
        return _Fault(error.message, error.hint)
    if time_names(names) or stamp_parts(names):
        return None
    if nameless(names):
        return _Fault("has no line of names", _NAME_IT)
    return _Fault("has no column of time", _NAME_IT)


def natural_order(paths: Iterable[Path]) -> list[Path]:
    """Sort paths so that numbers in names count as numbers."""

    def key(path: Path) -> tuple[list[int | str], str]:
        # Texts and numbers in turn, a text first, so that like is compared with like.
        parts: list[int | str] = []
        for k, part in enumerate(re.split(r"([0-9]+)", str(path))):
            parts.append(int(part) if k % 2 else part)
        return parts, str(path)

    return sorted(paths, key=key)


def _nearby(path: Path) -> str:
    """Return a hint that names files of a similar name."""
    try:
        names = os.listdir(path.parent)  # noqa: PTH208 (a missing folder must raise here)
    except (OSError, ValueError):
        return f"The folder {path.parent} does not exist either."
    similar = difflib.get_close_matches(path.name, names, n=3)
    return f"Did you mean {', '.join(similar)}?" if similar else "Check the path."
