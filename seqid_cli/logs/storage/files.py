"""Which files are meant, and whether they can be logs: a wrong path fails before heavy imports."""

import difflib
import glob
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.remote import StoredLog, is_url, stored_logs
from seqid_cli.logs.tables.csv_form import is_text, nameless, read_form
from seqid_cli.logs.tables.naming_schemes import stamp_parts, time_names
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
    ' "VariableNames", ["time" "q1" "q2" "i1" "i2"])).'
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
_HEAD = 4096
_OTHER = "is neither Parquet nor MCAP, no ROS bag and no CSV table"
_NAME_IT = "Name the file itself, or write *.csv, if it is a log."
_NOTES = (".toml", ".json", ".yaml", ".urdf", ".xml", ".md", ".py")
_TEXTS = (*CSV_SUFFIXES, ".txt", ".log", ".dat")

State = tuple[int, ...]
Stamps = tuple[float, float]
Note = Callable[[str], None]


def expand(
    paths: Sequence[str], note: Note | None = None, *, stored: bool = False
) -> list[Path]:
    """Turn files, folders and globs into log files.

    `paths`: files (taken whatever their suffix), folders (searched at any depth for the
    suffixes of logs, hidden files left out; a ROS 2 bag is such a folder) and globs
    (`**` for any depth). `note`: told what was left out, and why. `stored`: whether
    URLs of object storage are welcome as well. Returns: in the natural order of their
    paths (`run2` before `run10`), so that results repeat bit by bit; each once. Raises
    InputError: an argument stands for no file at all.
    """
    found: dict[Path, Path] = {}
    for argument in map(str, paths):
        if is_url(argument) and not stored:
            message = "is on object storage, which this command does not read"
            raise InputError(message, hint="Copy it here first.", where=argument)
        try:
            if is_url(argument):
                matches = natural_order(stored_logs(argument, SUFFIXES))
            else:
                matches = _matches(argument, note or (lambda text: None))
        except OSError as error:
            raise InputError(
                f"cannot be looked up ({error})", where=argument
            ) from error
        for path in matches:
            found.setdefault(path.resolve(), path)
    return natural_order(found.values())


def storage_file(path: Path) -> Path:
    """Return the one file of a ROS 2 bag folder that holds its messages; a file as it is."""
    if not path.is_dir():
        return path
    if not (path / METADATA).is_file():
        hint = "Name the files in it or use a glob."
        raise InputError("is a folder, not a log", hint=hint, where=str(path))
    files = _logs_in(path, lambda text: None)
    if len(files) == 1:
        return files[0]
    what = f"of {len(files)} files" if files else "without *.mcap and *.db3"
    hint = "Name its files." if files else "Unpack what is compressed: `zstd -d FILE`."
    raise InputError(f"is a ROS 2 bag {what}", hint=hint, where=str(path))


def sha256_of(path: Path) -> str:
    """Digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def time_of_log(path: Path, stamps_s: Stamps | None) -> float | None:
    """Return the time of a log [s, Unix] with this first and last stamp [s, its own clock].

    It is the last stamp where the stamps are dates, else when the file was last
    modified; None where that is not known either, as of a table in memory.
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
    """What tells that a file is another one than before."""
    now = path.stat()
    return now.st_size, now.st_mtime_ns, now.st_ino


@contextmanager
def unchanged(path: Path, before: State | None = None) -> Iterator[None]:
    """Read a log; raises InputError if it cannot be read, or changes from its state `before`."""
    try:
        first = before or state_of(path)
        yield
        same = state_of(path) == first
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    if not same:
        hint = "Wait until it is recorded or copied, then run this again."
        raise InputError("changed while it was read", hint=hint, where=str(path))


def check_log(path: Path) -> str:
    """Tell the format by the first bytes: parquet, mcap, csv, rosbag2 (an SQLite file), rosbag1.

    Raises InputError: the file is missing, unreadable, empty, cut short or of another
    kind.
    """
    where = str(path)
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
            tail = file.read(4)
    except FileNotFoundError as error:
        raise InputError("does not exist", hint=_nearby(path), where=where) from error
    except PermissionError as error:
        raise InputError(
            "may not be read", hint="Check its permissions.", where=where
        ) from error
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be opened ({error})", where=where) from error
    if not size:
        raise InputError(
            "is empty (0 bytes)", hint="Record or copy it again.", where=where
        )
    kind = _format(head, where)
    if kind == "parquet" and (tail != MAGIC[kind] or size < 12):
        text = (
            f"the Parquet file is cut short or damaged: its footer is missing ({size}"
            " bytes)"
        )
        hint = (
            "Parquet keeps its index at the end, so nothing can be salvaged: copy it"
            " again "
        )
        raise InputError(
            text, hint=hint + "from the source or record again.", where=where
        )
    try:
        if kind == "csv":
            read_form(path)
    except InputError as error:
        if path.suffix.lower() not in _TEXTS:
            error.message = f"{_OTHER}: {error.message}"
        raise
    return kind


def _format(head: bytes, where: str) -> str:
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
    hint = (
        "Logs are told by their content, not by their suffix: convert it to one of"
        " these."
    )
    raise InputError(f"{_OTHER} (it starts with {head[:8]!r})", hint=hint, where=where)


def _matches(argument: str, note: Note) -> list[Path]:
    path = Path(argument)
    if path.is_dir():
        return _logs_in(path, note) or _no_logs(path)
    if path.exists():
        return [path]
    if not glob.has_magic(argument):
        raise InputError("does not exist", hint=_nearby(path), where=argument)
    if found := _globbed(argument, note):
        return found
    hint = "Check the folder and the suffix."
    raise InputError("this pattern matches no file", hint=hint, where=argument)


def _no_logs(folder: Path, *, looked_at: int = 20) -> list[Path]:
    """Say that a folder has no logs, and why the first file is none that might be one."""
    message = (
        f"there is no log in this folder ({', '.join('*' + end for end in SUFFIXES)})"
    )
    hint = "Name the folder of the logs."
    for path in natural_order(path for path in folder.rglob("*") if path.is_file())[
        :looked_at
    ]:
        reason, remedy = _fault_of(path) if path.suffix not in _NOTES else (_OTHER, "")
        if not reason.startswith(_OTHER):
            message += f"; {path.name} {reason or 'is a table of another suffix'}"
            hint = remedy or _NAME_IT
            break
    raise InputError(message, hint=hint, where=str(folder))


def _globbed(pattern: str, note: Note) -> list[Path]:
    found: list[Path] = []
    names = glob.glob(pattern, recursive=True)  # noqa: PTH207 (patterns may be absolute)
    for path in natural_order(Path(name) for name in names):
        # A pattern such as logs/** also matches folders and files that are no logs.
        found += _logs_in(path, note) if path.is_dir() and "**" not in pattern else []
        found += [path] if path.is_file() else []
    logs = [path for path in found if path.suffix.lower() in SUFFIXES]
    if pattern.lower().endswith(CSV_SUFFIXES):  # then they are named explicitly
        return logs or found
    return [path for path in logs if _is_meant(path, note)] or ([] if logs else found)


def _logs_in(folder: Path, note: Note) -> list[Path]:
    """Logs in a folder; tables under `meta` belong to the description of a LeRobot data set."""
    candidates = natural_order(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in SUFFIXES
        and not path.name.startswith(".")
        and path.is_file()
        and not any(
            p.name == "meta" and (p / "info.json").is_file() for p in path.parents
        )
    )
    return [path for path in candidates if _is_meant(path, note)]


def _is_meant(path: Path, note: Note) -> bool:
    """Tell whether a file that was not named itself is a log: CSV files are all sorts of things."""
    text = ""
    if path.suffix.lower() == ".parquet":
        from seqid_cli.logs.tables.parquet import list_columns

        with suppress(InputError):
            ends = {name.rpartition(".")[2] for name in list_columns(path)}
            # A table of `predict --torques`: its torques are of logs that count
            # already.
            if {"predicted", "residual", "sliding"} <= ends:
                text = "seqid predict wrote it"
    elif path.suffix.lower() in CSV_SUFFIXES and (reason := _fault_of(path)[0]):
        text = f"it {reason}; name the file itself if it is one"
    if text:
        note(f"{path} is left out, it is no log: {text}")
    return not text


def _fault_of(path: Path) -> tuple[str, str]:
    """Why a file is no log, empty where it is one, and what to do."""
    try:
        names = read_form(path).names if check_log(path) == "csv" else ("t",)
    except InputError as error:
        return error.message, error.hint
    if time_names(names) or stamp_parts(names):
        return "", ""
    return (
        "has no line of names" if nameless(names) else "has no column of time"
    ), _NAME_IT


def natural_order(paths: Iterable[Path]) -> list[Path]:
    """Sort paths so that numbers in names count as numbers."""

    def key(path: Path) -> tuple[list[int | str], str]:
        # a text first, then in turn
        parts = enumerate(re.split(r"([0-9]+)", str(path)))
        return [int(part) if i % 2 else part for i, part in parts], str(path)

    return sorted(paths, key=key)


def _nearby(path: Path) -> str:
    try:
        names = os.listdir(path.parent)  # noqa: PTH208 (a missing folder must raise here)
    except (OSError, ValueError):
        return f"The folder {path.parent} does not exist either."
    close = difflib.get_close_matches(path.name, names, n=3)
    return f"Did you mean {', '.join(close)}?" if close else "Check the path."
