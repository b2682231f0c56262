"""A bounded, evenly spread sample of a stream of rows."""

import numpy as np

from seqid_cli.logs.raw import Array

MOST = 262_144


class Thinned:
    """Keeps every row until there are more than `most`, then every second one, fourth and so on.

    What is kept, at least half of `most`, depends on the rows alone, not on how they came.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._parts: list[Array] = []
        self._every, self._seen, self._kept = 1, 0, 0

    def push(self, rows: Array) -> None:
        """Take the next rows (M, ...)."""
        self._parts.append(rows[-self._seen % self._every :: self._every].copy(order="K"))
        self._seen += len(rows)
        self._kept += len(self._parts[-1])
        while self._kept > self._most:
            self._parts = [np.concatenate(self._parts)[::2].copy(order="K")]
            self._every *= 2
            self._kept = len(self._parts[0])

    @property
    def rows(self) -> Array:
        """What is kept."""
        return np.concatenate(self._parts) if self._parts else np.zeros(0)
