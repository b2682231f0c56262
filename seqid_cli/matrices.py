"""Matrices made of others, as `scipy.linalg` has them, without its import."""

import numpy as np

from seqid_cli.typing import Array


def block_diagonal(*blocks: Array) -> Array:
    """Return blocks (m_i, n_i) along the diagonal of zeros (sum m_i, sum n_i)."""
    ends = np.cumsum([block.shape for block in blocks], axis=0)
    matrix = np.zeros(ends[-1])
    for block, (row, column) in zip(blocks, ends, strict=True):
        matrix[row - block.shape[0] : row, column - block.shape[1] : column] = block
    return matrix
