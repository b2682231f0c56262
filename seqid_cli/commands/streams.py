"""Standard streams that are closed, full or cannot spell a name; signals that end a run."""

from __future__ import annotations

import errno
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import NoReturn

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF})
ENDING = ("SIGTERM", "SIGHUP")  # like Ctrl-C; there is no SIGHUP on Windows


def prepare_process() -> None:
    """Make the streams of a program of its own safe to write to, and its end orderly.

    Characters that a stream cannot spell are written as escapes; a closed stream swallows all.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    for name in ENDING:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    del number, frame
    raise KeyboardInterrupt


def cannot_be_written(error: OSError) -> bool:
    """Whether it is a stream that failed, of which no file is told."""
    return error.filename is None and error.errno in FULL


def give_up_output() -> None:
    """Send to nowhere what is still to be written, so that the interpreter ends in peace."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # a stream that is no file needs no care
        return
