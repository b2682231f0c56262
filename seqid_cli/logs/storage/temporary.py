"""Folders for copies of logs, which go with the run that made them, and rows set aside.

Decoding a compressed column costs ten times what reading it back costs. The rows' file lies where
temporary files do (`TMPDIR`) and goes with whoever holds it.
"""

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Array, Stamps
from seqid_cli.params.files import process_runs


class Spool:
    """Takes rows, up to `most_bytes` and a `share` of the free space, and gives them back."""

    def __init__(self, most_bytes: int = 1 << 31, share: float = 0.25) -> None:
        self._file: IO[bytes] | None = None
        self._shapes: list[tuple[int, int]] = []
        self._size = 0
        try:
            self._most = min(most_bytes, share * shutil.disk_usage(tempfile.gettempdir()).free)
            self._file = tempfile.TemporaryFile(prefix="seqid-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        except OSError:
            self._give_up()

    @property
    def complete(self) -> bool:
        """Whether all rows that were pushed are there."""
        return self._file is not None

    def push(self, stamps: Stamps, values: Array) -> None:
        """Take the next rows: stamps (M,) ns, values (M, c)."""
        if self._file is None:
            return
        size = stamps.nbytes + values.nbytes
        try:
            if self._size + size > self._most:
                raise OSError("too many rows")
            # Room that is asked for at once costs a third of what it costs page by page.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._file.fileno(), self._size, size)
            stamps.tofile(self._file)
            np.ascontiguousarray(values.T).tofile(self._file)
        except OSError:
            self._give_up()
            return
        self._size += size
        self._shapes.append(values.shape)

    def _give_up(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def parts(self) -> Iterator[tuple[Stamps, Array]]:
        """Yield the rows as they came; they may be overwritten."""
        assert self._file is not None
        place = 0
        for rows, columns in self._shapes:
            self._file.seek(place)
            stamps = np.fromfile(self._file, np.int64, rows)
            values = np.fromfile(self._file, np.float64, rows * columns)
            if len(values) < rows * columns:
                raise OSError("the temporary file of the decoded rows was cut short")
            place += stamps.nbytes + values.nbytes
            yield stamps, values.reshape(columns, rows).T


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
