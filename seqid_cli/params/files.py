"""Files that are replaced in one step: a reader sees the old content or the new.

A file is written beside its place, under a random name, and then takes the place. The
writer holds a lock on it as long as it lives: what no run holds was left by one that
was killed. Numbers of processes would not do, as two containers may have the same.
"""

import contextlib
import errno
import glob
import os
import re
import secrets
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal, TypeVar

from seqid_cli.errors import UsageError

# A file that no lock protects is abandoned when it was not written to for a day.
_ABANDONED_S = 86400.0
# Who removes what is abandoned may take a new file for it before it is locked: another
# is made, so often.
_TRIES = 10

T = TypeVar("T")
By = Literal["name", "folder"]  # that tells robots apart
# Names of the process's own streams, which may be files, if piped.
_STREAM = re.compile("-|/dev/std(out|err)|/(dev|proc/self)/fd/[0-9]+")


def check_output(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Find out before any work whether a file can be written.

    Parameters
    ----------
    path : Path
        The file.
    inputs : iterable of Path
        Files that are read: none of them is overwritten.

    Raises
    ------
    UsageError
        The folder is missing or takes no file of this name, `path` is a folder, or it
        is one of `inputs`.
    """
    with writing(path):
        _check_place(path)
        for source in inputs:
            if _is_same_file(path, source):
                raise UsageError(
                    "is an input of this command",
                    where=str(path),
                    hint="Choose another output, the input is never overwritten.",
                )
        # The rights of a folder do not say all: some names, and some file systems, are
        # refused only when a file is made.
        if not _is_special(path):
            with _temporary(_target(path)):
                pass


def _check_place(path: Path) -> None:
    """Raise UsageError where a path is no place for a file, by what stands there."""
    folder = path.parent
    is_special = _is_special(path)
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
    if is_special and path != Path(os.devnull):
        hint = (
            "A pipe or a device may wait without end: name a file, and copy it there"
            " afterwards."
        )
        raise UsageError("is no regular file", where=str(path), hint=hint)
    if not os.access(path if is_special else folder, os.W_OK):
        message = f"the folder {folder} is not writable"
        raise UsageError(
            message, where=str(path), hint="Choose another output with -o."
        )


def _is_same_file(path: Path, source: Path) -> bool:
    """Return whether two paths name one file, also where it does not exist yet."""
    if path.exists() and source.exists():
        return path.samefile(source)
    return _target(path) == _target(source)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of the file system in the block, which writes `path`, into messages.

    Raises
    ------
    UsageError
        The file system refused something.
    """
    try:
        yield
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise UsageError(
            message, where=str(path), hint="Check space and rights there."
        ) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` when the block ends well.

    When the block raises, or the process dies in it, `path` stays as it was. A device
    such as /dev/null is written directly. Only the replacement itself is turned into a
    message here; the block wraps its own writing in `writing`.

    Raises
    ------
    UsageError
        The file system refused the replacement.
    """
    if _is_special(path):
        yield path
        return
    target = _target(path)
    _without_leftovers(target)
    with contextlib.ExitStack() as stack:
        with writing(path):
            temporary = stack.enter_context(_temporary(target))
        yield temporary
        with writing(path):
            _sync(temporary)
            temporary.replace(target)
            _sync(target.parent)


def _target(path: Path) -> Path:
    """Return the file that a path stands for, behind all links."""
    return Path(os.path.realpath(path))  # `Path.resolve` fails at a link to itself


@contextlib.contextmanager
def _temporary(target: Path) -> Iterator[Path]:
    """Make an empty file beside a file, held as long as the block; it is removed."""

    def made() -> Path:
        name = f".{_short(target.name)}.{secrets.token_hex(8)}.tmp"
        path = target.with_name(name)
        paths.append(path)  # first: an interrupt may come as soon as the file is there
        path.touch(exist_ok=False)
        return path

    paths: list[Path] = []
    try:
        with held(made) as path:
            yield path
    finally:
        for path in paths:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)


def _short(name: str, most: int = 200) -> str:
    """Return a name with room for more within the 255 bytes that file systems allow."""
    encoded = os.fsencode(name)
    return name if len(encoded) <= most else f"{zlib.crc32(encoded):08x}"


def leftovers(target: Path) -> Iterator[Path]:
    """Yield the temporary files of a file: of killed runs, and of those that live."""
    yield from target.parent.glob(f".{glob.escape(_short(target.name))}.*.tmp")


def _without_leftovers(target: Path) -> None:
    """Remove temporary files that killed runs left beside a file."""
    for path in leftovers(target):
        if is_abandoned(path):
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)


@contextlib.contextmanager
def held(make: Callable[[], Path]) -> Iterator[Path]:
    """Make a file or a folder and hold it while the block lasts, or the process lives.

    Where the system has no such locks, as Windows or some network drives, nothing is
    held: `is_abandoned` goes by age there.

    Parameters
    ----------
    make : callable
        Makes an empty file or folder of a name that no other has.
    """
    for _ in range(_TRIES):
        path = make()
        try:
            handle = _locked(path)
        except OSError:
            continue
        if handle is None or path.exists():
            break
        os.close(handle)
    else:
        raise FileNotFoundError(errno.ENOENT, "its temporary file is removed each time")
    try:
        yield path
    finally:
        if handle is not None:
            os.close(handle)


def is_abandoned(path: Path) -> bool:
    """Tell whether no run holds a file or a folder; by age where no lock can tell."""
    try:
        age_s = time.time() - path.stat().st_mtime
        handle = _locked(path)
    except OSError:  # held, or gone, or of somebody else
        return False
    if handle is None:
        return age_s > _ABANDONED_S
    os.close(handle)
    return True


def _locked(path: Path) -> int | None:
    """Return a handle that holds a lock on a path; None where there are no locks.

    Raises
    ------
    BlockingIOError
        Another process, or another part of this one, holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:  # a network drive without locks
        os.close(handle)
        return None
    return handle


def write_text_atomic(path: Path, text: str, *, inputs: Iterable[Path] = ()) -> None:
    """Write UTF-8 text in one step.

    Errors are those of `check_output` and `writing`; none of `inputs` is overwritten.
    """
    check_output(path, inputs)
    with replacing(path) as temporary, writing(path):
        temporary.write_text(text, encoding="utf-8")


def _is_special(path: Path) -> bool:
    """Return whether a path is a device or a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _sync(path: Path) -> None:
    """Have a file, or a folder's list of files, written to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def by_robot(files: Sequence[tuple[str, str, T]], by: By) -> dict[str, list[T]]:
    """Group things by their robots.

    Parameters
    ----------
    files : sequence of (path, name, thing)
        Things with the file that they are from, and the robot's name in it.
    by : {"name", "folder"}
        What tells robots apart. By folder a robot's name is the file's folder, without
        the part that is common to all of them.
    """
    if by == "name":
        names = [name for _, name, _ in files]
    else:
        folders = [Path(path).parent.absolute() for path, _, _ in files]
        names = _names_of_folders(folders)
    things: dict[str, list[T]] = {}
    for name, (_, _, thing) in zip(names, files, strict=True):
        things.setdefault(name, []).append(thing)
    return things


def _names_of_folders(folders: Sequence[Path]) -> list[str]:
    """Return the parts of folders by which they differ; the name where they do not."""
    common = Path(os.path.commonpath(folders))
    if set(folders) == {common}:
        return [common.name] * len(folders)
    return [str(folder.relative_to(common)) for folder in folders]
