"""Which file is being read, noted where it can be seen after this process has died.

A library in which a damaged file sets off a fault ends the process: no message can come
from here then. `commands.guard` watches the process, finds the note, and starts the
command again. It knows by then which file that was, and refuses it. Standard library
only.
"""

import contextlib
import mmap
import os
from contextvars import ContextVar

from seqid_cli.errors import InputError

TYPE_CHECKING = False
if TYPE_CHECKING:  # this is imported before signals are answered
    from collections.abc import Iterator, Mapping
    from pathlib import Path

_LONGEST = 4096  # bytes of a path, on any system


class Note:
    """A page of memory that a process and the one that watches it share.

    `deadly` are the files by which an earlier process died, with the signal's name.
    """

    def __init__(self, deadly: "Mapping[str, str]") -> None:
        self.deadly = dict(deadly)
        self._page = mmap.mmap(-1, _LONGEST)

    def write(self, path: str) -> None:
        """Note the file that is read from now on; an empty text is none."""
        raw = os.fsencode(path)[: _LONGEST - 1]
        self._page[: len(raw) + 1] = raw + b"\0"

    def read(self) -> str:
        """Return the file that was read last, empty if none was."""
        return os.fsdecode(self._page[:].partition(b"\0")[0])


_note: ContextVar[Note | None] = ContextVar("note", default=None)


def note_in(note: Note) -> None:
    """Note from now on what is read."""
    _note.set(note)


@contextlib.contextmanager
def being_read(path: "Path") -> "Iterator[None]":
    """Note that a file is read in this block.

    Raises
    ------
    InputError
        It has ended a process that read it.
    """
    note = _note.get()
    if note is None:
        yield
        return
    # A link in its place, or another way of writing it, is the same file.
    name = os.path.realpath(path)
    if name in note.deadly:
        raise InputError(
            f"the library that reads it dies of it ({note.deadly[name]})",
            hint="It is damaged, or memory is: copy it again from the source.",
            where=str(path),
        )
    outer = note.read()
    note.write(name)
    try:
        yield
    finally:
        note.write(outer)
