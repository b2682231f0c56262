"""Replace a file in one step: a reader sees the old content or the new, never a part."""

import contextlib
import glob
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal, TypeVar

from seqid_cli.errors import UsageError

T = TypeVar("T")
By = Literal["name", "folder"]  # what tells robots apart
# may be a file, if piped
_STREAM = re.compile("-|/dev/std(out|err)|/(dev|proc/self)/fd/[0-9]+")


def check_output(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Find out before any work whether `path` can be written.

    Raises UsageError: the folder is missing or takes no file of this name, `path` is a
    folder, or it is one of `inputs`.
    """
    with writing(path):
        folder, special = path.parent, _is_special(path)
        if _STREAM.fullmatch(str(path)):
            raise UsageError(
                "an output must be a file", hint="Use --json to print the result."
            )
        if not folder.is_dir():
            hint = f"Make it: mkdir -p {folder}"
            raise UsageError("its folder does not exist", where=str(path), hint=hint)
        if path.is_dir():
            raise UsageError(
                "is a folder, not a file", where=str(path), hint="Name a file in it."
            )
        if special and path != Path(os.devnull):
            hint = (
                "A pipe or a device may wait without end: name a file, and copy it"
                " there "
            )
            raise UsageError(
                "is no regular file", where=str(path), hint=f"{hint}afterwards."
            )
        if not os.access(path if special else folder, os.W_OK):
            message = f"the folder {folder} is not writable"
            raise UsageError(
                message, where=str(path), hint="Choose another output with -o."
            )
        for source in inputs:
            both = path.exists() and source.exists()
            if path.samefile(source) if both else _target(path) == _target(source):
                hint = "Choose another output, the input is never overwritten."
                raise UsageError(
                    "is an input of this command", where=str(path), hint=hint
                )
        if not special:
            trial = _temporary(_target(path))
            trial.touch()
            trial.unlink()


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an error of the file system while `path` is written in the block into a UsageError."""
    try:
        yield
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise UsageError(
            message, where=str(path), hint="Check space and rights there."
        ) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that takes its place when the block ends well.

    When the block raises, or the process dies in it, `path` stays as it was. A device
    such as /dev/null is written directly. Only the replacement itself is turned into a
    message here; the block wraps its own writing in `writing`. Raises UsageError: the
    file system refused the replacement.
    """
    if _is_special(path):
        yield path
        return
    target = _target(path)
    _without_leftovers(target)
    temporary = _temporary(target)
    try:
        yield temporary
        with writing(path):
            _sync(temporary)
            temporary.replace(target)
            _sync(target.parent)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _target(path: Path) -> Path:
    return Path(os.path.realpath(path))  # `Path.resolve` fails at a link to itself


def _temporary(target: Path) -> Path:
    return target.with_name(f".{_short(target.name)}.{os.getpid()}.tmp")


def _short(name: str, most: int = 200) -> str:
    """A name that leaves room for more within the 255 bytes that file systems allow."""
    raw = os.fsencode(name)
    return name if len(raw) <= most else f"{zlib.crc32(raw):08x}"


def _without_leftovers(target: Path) -> None:
    """Remove temporary files that killed runs left beside a file."""
    for path in target.parent.glob(f".{glob.escape(_short(target.name))}.*.tmp"):
        process = path.suffixes[-2][1:]
        if process.isdecimal() and not process_runs(int(process)):
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)


def process_runs(process: int) -> bool:
    """Tell whether there is a process of this number."""
    try:
        os.kill(process, 0)
    # any other one: the process is somebody else's
    except (OSError, OverflowError) as error:
        return not isinstance(error, ProcessLookupError)
    return True


def write_text_atomic(path: Path, text: str, *, inputs: Iterable[Path] = ()) -> None:
    """Write UTF-8 text to `path` in one step; see `check_output` and `writing` for errors."""
    check_output(path, inputs)
    with replacing(path) as temporary, writing(path):
        temporary.write_text(text, encoding="utf-8")


def _is_special(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def by_robot(files: Sequence[tuple[str, str, T]], by: By) -> dict[str, list[T]]:
    """Sort things by their robots; each is given with its path and the name of the robot in it.

    By `folder` a robot's name is the file's folder, without what is common to all of
    them.
    """
    folders = [Path(path).parent.absolute() for path, _, _ in files]
    common = Path(os.path.commonpath(folders)) if by == "folder" else Path()
    found: dict[str, list[T]] = {}
    for folder, (_, name, item) in zip(folders, files, strict=True):
        if by == "folder":
            name = (
                common.name
                if {*folders} == {common}
                else str(folder.relative_to(common))
            )
        found.setdefault(name, []).append(item)
    return found
