"""Decoded rows set aside on the disk.

Decoding a compressed column costs ten times what reading it back costs. The file of a
spool lies where temporary files do (`TMPDIR`), has no name where the system allows, and
goes with whoever holds it. Where there is too little room, or the rows become too many,
there is none.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from seqid_cli.logs.raw import Array, Stamps


class Spool:
    """Takes rows and gives them back.

    Parameters
    ----------
    most_bytes : int
        Bytes of rows that it takes.
    share : float
        Of the free space that it takes at most.
    """

    def __init__(self, most_bytes: int = 1 << 31, share: float = 0.25) -> None:
        self._file: IO[bytes] | None = None
        self._shapes: list[tuple[int, int]] = []
        self._size = 0
        try:
            free = shutil.disk_usage(tempfile.gettempdir()).free
            self._limit = min(most_bytes, share * free)
            self._file = tempfile.TemporaryFile(prefix="seqid-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        except OSError:
            self._give_up()

    @property
    def complete(self) -> bool:
        """True while all rows that were pushed are there."""
        return self._file is not None

    def push(self, stamps: Stamps, values: Array) -> None:
        """Take the next rows: stamps (M,) ns, values (M, c)."""
        import numpy as np

        if self._file is None:
            return
        size = stamps.nbytes + values.nbytes
        try:
            if self._size + size > self._limit:
                raise OSError("too many rows")
            # Room that is asked for at once costs a third of what it costs page by
            # page.
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
        """Yield stamps and values as they came; they may be overwritten."""
        import numpy as np

        assert self._file is not None
        place = 0
        for n_rows, n_columns in self._shapes:
            self._file.seek(place)
            stamps = np.fromfile(self._file, np.int64, n_rows)
            values = np.fromfile(self._file, np.float64, n_rows * n_columns)
            if len(values) < n_rows * n_columns:
                raise OSError("the temporary file of the decoded rows was cut short")
            place += stamps.nbytes + values.nbytes
            yield stamps, values.reshape(n_columns, n_rows).T
