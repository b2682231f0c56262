"""Folders for copies of logs, which go with the run that made them, or with the next."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from seqid_cli.errors import InputError
from seqid_cli.params.files import process_runs


@contextmanager
def temporary_folder(where: str) -> Iterator[Path]:
    """Yield an empty folder; those that killed runs left are removed first.

    Raises InputError: there is no room for it; `where` is the log that is to be copied.
    """
    for left in Path(tempfile.gettempdir()).glob("seqid-*-*"):
        process = left.name.split("-")[1]
        if process.isdecimal() and not process_runs(int(process)):
            shutil.rmtree(left, ignore_errors=True)
    with room_for_copies(where):
        folder = tempfile.TemporaryDirectory(prefix=f"seqid-{os.getpid()}-")
    with folder as name:
        yield Path(name)


@contextmanager
def room_for_copies(where: str) -> Iterator[None]:
    """Turn an error of the file system while a log is copied into a message.

    Raises InputError: the log `where` cannot be read, or there is no room for its copy.
    """
    try:
        yield
    except OSError as error:
        message = f"cannot be copied: {error.strerror or error}"
        hint = f"Check the space for temporary files in {tempfile.gettempdir()} (TMPDIR)."
        raise InputError(message, hint=hint, where=where) from error
