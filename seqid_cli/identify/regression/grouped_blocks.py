"""Blocks of equations reduced together where they would be merged in any case.

A long log has more blocks of a second than are kept apart (`least_squares.MOST_BLOCKS`). Where it
is known beforehand how many will come, those that end up in one factor are reduced in one go: the
same factor, with fewer and larger QR decompositions.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.identify.regression.least_squares import MOST_BLOCKS, Accumulator
from seqid_cli.typing import Array, Mask

MOST_ROWS = 4096  # held for one factor; what more there is to merge is merged afterwards

Chunk = tuple[Array, Array, Mask]  # H (N, n, p), y (N, n), which rows to use (N, n)


class GroupedBlocks:
    """Hands the rows of all joints, block by block, to their accumulators."""

    def __init__(self, joints: Sequence[Accumulator]) -> None:
        self._joints = joints
        self._group = 1
        self._held: list[Chunk] = []
        self._filled = 0  # blocks of what is held

    def expect(self, count: int, rows: int) -> None:
        """So many blocks of about so many rows of one log follow; 0 when they have come."""
        self._add_held()
        self._group = 1
        while -(-count // self._group) > MOST_BLOCKS and 2 * self._group * rows <= MOST_ROWS:
            self._group *= 2

    def add(self, chunk: Chunk, ends: Sequence[int]) -> None:
        """Add the rows of a chunk in blocks that end at `ends`; its memory may be used again."""
        start = 0
        for end in ends:
            self._filled += 1
            if self._filled == self._group:
                self._held.append(_cut(chunk, start, end))
                self._add_held()
                start = end
        if start < ends[-1]:
            H, y, used = _cut(chunk, start, ends[-1])
            self._held.append((H.copy(order="K"), y.copy(), used.copy()))

    def _add_held(self) -> None:
        if self._held:
            H, y, used = (
                parts[0] if len(parts) == 1 else np.concatenate(parts)
                for parts in zip(*self._held, strict=True)
            )
            for j, joint in enumerate(self._joints):
                joint.add(H[:, j], y[:, j], used[:, j])
        self._held, self._filled = [], 0


def _cut(chunk: Chunk, start: int, stop: int) -> Chunk:
    H, y, used = chunk
    return H[start:stop], y[start:stop], used[start:stop]
