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
    """Yield an empty folder for a copy; those that killed runs left are removed first."""
    for left in Path(tempfile.gettempdir()).glob("seqid-*-*"):
        process = left.name.split("-")[1]
        if process.isdecimal() and not process_runs(int(process)):
            shutil.rmtree(left, ignore_errors=True)
    try:
        folder = tempfile.TemporaryDirectory(prefix=f"seqid-{os.getpid()}-")
    except OSError as error:
        message = f"cannot be copied: {error.strerror or error}"
        hint = f"Check the space for temporary files in {tempfile.gettempdir()} (TMPDIR)."
        raise InputError(message, hint=hint, where=where) from error
    with folder as name:
        yield Path(name)
