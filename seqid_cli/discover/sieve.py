"""Low-pass and choice of rows in one matrix, applied to many columns at once.

Rows that follow each other need nearly the same samples, so the matrix is kept as dense tiles of
some rows each: twice the multiplications of a sparse product, at many times its speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from seqid_cli.motion.filtering import Lowpass, runs
from seqid_cli.motion.motion import Motion

Array = NDArray[np.float64]
Index = NDArray[np.intp]

REACH = 6  # of the low-pass's settling: what lies further off weighs less than 1e-4 in all
TILE = 32  # rows


@dataclass(frozen=True)
class Tile:
    """Weights (rows, samples) of the samples from `first` on in the rows from `row` on."""

    row: int
    first: int
    weights: Array


@dataclass(frozen=True)
class Sieve:
    """Weights (M, N) of all samples in every row, as tiles."""

    rows: int
    tiles: tuple[Tile, ...]

    @classmethod
    def of(cls, motion: Motion, picked: Index, passes: int) -> Sieve:
        """Weights after so many passes of the motion's low-pass, at the samples `picked` (M,)."""
        weights = _weights_of_all(motion, picked, passes)
        tiles = [_tile(weights, row) for row in range(0, len(picked), TILE)]
        return cls(len(picked), tuple(tile for tile in tiles if tile.weights.size))

    def __matmul__(self, values: Array) -> Array:
        """Rows (M, K) of values (N, K)."""
        result = np.zeros((self.rows, values.shape[1]))
        for tile in self.tiles:
            count, width = tile.weights.shape
            part = values[tile.first : tile.first + width]
            np.matmul(tile.weights, part, out=result[tile.row : tile.row + count])
        return result

    def part(self, first: int, values: Array) -> tuple[int, Array]:
        """Of values (m, K) at the samples from `first` on, zero elsewhere: first row, rows (r, K).

        Rows that feel none of these samples are left out at both ends.
        """
        last = first + len(values)
        felt = [t for t in self.tiles if t.first < last and t.first + t.weights.shape[1] > first]
        if not felt:
            return 0, np.zeros((0, values.shape[1]))
        row = felt[0].row
        result = np.zeros((felt[-1].row + len(felt[-1].weights) - row, values.shape[1]))
        for tile in felt:
            low, high = max(first, tile.first), min(last, tile.first + tile.weights.shape[1])
            weights = tile.weights[:, low - tile.first : high - tile.first]
            result[tile.row - row : tile.row - row + len(weights)] = (
                weights @ values[low - first : high - first]
            )
        return row, result


def _tile(weights: csr_array, row: int) -> Tile:
    part = weights[row : row + TILE]
    if not part.nnz:
        return Tile(row, 0, np.zeros((0, 0)))
    low, high = int(part.indices.min()), int(part.indices.max()) + 1
    return Tile(row, low, part[:, low:high].toarray())


def _weights_of_all(motion: Motion, picked: Index, passes: int) -> csr_array:
    """Weights of all samples in every picked one after the low-pass, (M, N)."""
    parts = [
        _weights(motion.lowpass, picked, run, passes) for run in runs(motion.valid, motion.samples)
    ]
    weight = np.concatenate([part[0] for part in parts])
    row, column = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    return csr_array((weight, (row, column)), shape=(len(picked), motion.samples))


def _weights(
    lowpass: Lowpass, picked: Index, run: tuple[int, int], passes: int
) -> tuple[Array, Index, Index]:
    """Weights, rows and samples of what is picked in one run of valid samples.

    The low-pass of a short piece has it all: rows near the ends take its first and last rows, all
    others its middle one.
    """
    start, samples = run[0], run[1] - run[0]
    reach = REACH * lowpass.settling if lowpass.active else 0
    length = min(samples, 3 * reach + 1)
    response = np.eye(length)
    for _ in range(passes):
        response = lowpass(response)
    row = np.flatnonzero((picked >= start) & (picked < run[1]))
    at = picked[row, None] - start
    piece = np.clip(at - length // 2, 0, samples - length)
    column = at + np.arange(-reach, reach + 1)
    inside = (column >= 0) & (column < samples)
    weight = response[at - piece, np.clip(column - piece, 0, length - 1)]
    rows = np.broadcast_to(row[:, None], column.shape)
    return weight[inside], rows[inside], column[inside] + start
