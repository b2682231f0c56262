"""Decoded rows set aside in a temporary file, to be passed over again without decoding.

Decoding a compressed column costs ten times what reading it back costs. The file lies where
temporary files do (`TMPDIR`), has no name where the system allows, and goes with whoever holds it.
Where there is too little room, or the rows become too many, there is none.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.raw import Array, Stamps

MOST_BYTES = 1 << 31
SHARE = 4  # of the free space, that at most is taken


class Spool:
    """Takes rows in parts, and gives them back as often as wanted; `complete` if all are there."""

    def __init__(self, most_bytes: int | None = None) -> None:
        self._file: IO[bytes] | None = None
        self._shapes: list[tuple[int, int]] = []
        self._size = 0
        self.complete = True
        try:
            free = shutil.disk_usage(tempfile.gettempdir()).free
            self._most = min(MOST_BYTES if most_bytes is None else most_bytes, free // SHARE)
            self._file = tempfile.TemporaryFile(prefix="seqid-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        except OSError:
            self._give_up()

    def push(self, stamps: Stamps, values: Array) -> None:
        """Take the next rows: stamps (M,) ns, values (M, c)."""
        if self._file is None:
            return
        self._size += stamps.nbytes + values.nbytes
        if self._size > self._most:
            self._give_up()
            return
        try:
            # Room that is asked for at once costs a third of what it costs page by page.
            if hasattr(os, "posix_fallocate"):
                before = self._size - stamps.nbytes - values.nbytes
                os.posix_fallocate(self._file.fileno(), before, self._size - before)
            for array in (stamps, values.T):
                left = _bytes_of(np.ascontiguousarray(array))
                while left:  # the system may take less than it is given
                    left = left[self._file.write(left) :]
        except OSError:
            self._give_up()
            return
        self._shapes.append(values.shape)

    def _give_up(self) -> None:
        self.complete = False
        if self._file is not None:
            self._file.close()
            self._file = None

    def parts(self) -> Iterator[tuple[Stamps, Array]]:
        """Yield the rows as they came; they may be overwritten."""
        assert self._file is not None
        place = 0
        for rows, columns in self._shapes:
            stamps, values = np.empty(rows, np.int64), np.empty((columns, rows))
            for array in (stamps, values):
                place = self._filled(_bytes_of(array), place)
            yield stamps, values.T

    def _filled(self, room: memoryview, place: int) -> int:
        """Fill memory from a place in the file; returns where it goes on."""
        assert self._file is not None
        while room:
            got = os.preadv(self._file.fileno(), [room], place)
            if not got:
                raise OSError("the temporary file of the decoded rows was cut short")
            room, place = room[got:], place + got
        return place


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data
