"""Standard streams that are closed, full or cannot spell a name."""

import errno
import io
import os
import sys
from pathlib import Path
from typing import TextIO

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF})


class Messages(io.TextIOWrapper):
    """Standard error.

    No result goes there: once it cannot be written, it swallows all.
    """

    def write(self, text: str, /) -> int:
        """Write a text, or lose it."""
        try:
            return super().write(text)
        except OSError:
            to_nowhere(self)
            return len(text)

    def flush(self) -> None:
        """Hand on what was written, or lose it."""
        try:
            super().flush()
        except OSError:
            to_nowhere(self)


def prepare_streams() -> None:
    """Make the streams of a program of its own safe to write to.

    Characters that a stream cannot spell are written as escapes; a closed stream
    swallows all, and so does standard error where it is full or nobody reads it.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, nowhere)
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    if isinstance(sys.stderr, io.TextIOWrapper):
        encoding = sys.stderr.encoding  # which the detached stream has no more
        buffer = sys.stderr.detach()
        sys.stderr = Messages(buffer, encoding, "backslashreplace", line_buffering=True)


def cannot_be_written(error: OSError) -> bool:
    """Return whether a stream failed: its reader has left, or no file is named."""
    return isinstance(error, BrokenPipeError) or (
        error.filename is None and error.errno in FULL
    )


def to_nowhere(stream: TextIO) -> None:
    """Lose what is still to be written, so that the interpreter ends in peace."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):  # a stream that is no file needs no care
        return
