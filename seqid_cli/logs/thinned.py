"""A sample of the rows of a long log, of bounded size."""

import numpy as np

from seqid_cli.typing import Array

MOST = 262_144


class Thinned:
    """Keeps every row until there are more than `most`, then every second, fourth, ...

    Which rows stay, at least half of `most`, depends on the rows alone, not on the
    blocks in which they come.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._parts: list[Array] = []
        self._stride = 1
        self._n_pushed = 0
        self._n_stored = 0

    def push(self, rows: Array) -> None:
        """Take the next rows (M, ...)."""
        first = -self._n_pushed % self._stride
        # A copy: a view would hold the whole block.
        part = rows[first :: self._stride].copy(order="K")
        self._parts.append(part)
        self._n_pushed += len(rows)
        self._n_stored += len(part)

        while self._n_stored > self._most:
            self._parts = [np.concatenate(self._parts)[::2].copy(order="K")]
            self._stride *= 2
            self._n_stored = len(self._parts[0])

    @property
    def rows(self) -> Array:
        """The rows that stay."""
        return np.concatenate(self._parts) if self._parts else np.zeros(0)
