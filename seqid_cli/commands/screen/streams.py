"""Standard streams that are closed, full or cannot spell a name."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF})


def prepare_streams() -> None:
    """Make the streams of a program of its own safe to write to.

    Characters that a stream cannot spell are written as escapes; a closed stream swallows all.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def cannot_be_written(error: OSError) -> bool:
    """Whether it is a stream that failed, of which no file is told, or whose reader has left."""
    return isinstance(error, BrokenPipeError) or (error.filename is None and error.errno in FULL)


def give_up_output() -> None:
    """Send to nowhere what is still to be written, so that the interpreter ends in peace."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # a stream that is no file needs no care
        return
