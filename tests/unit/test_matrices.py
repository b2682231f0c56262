"""Blocks along a diagonal are those of `scipy.linalg`."""

import numpy as np
from scipy.linalg import block_diag

from seqid_cli.matrices import block_diagonal


def test_blocks_of_any_shape() -> None:
    blocks = [np.ones((2, 3)), np.zeros((0, 0)), np.full((1, 1), 2.0), np.eye(4)]
    np.testing.assert_array_equal(block_diagonal(*blocks), block_diag(*blocks))
