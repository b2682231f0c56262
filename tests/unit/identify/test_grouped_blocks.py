"""Blocks reduced together are the blocks merged afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.identify.regression import grouped_blocks, least_squares
from seqid_cli.identify.regression.grouped_blocks import GroupedBlocks
from seqid_cli.identify.regression.least_squares import Accumulator

N, P, ROWS = 2, 3, 10


@pytest.mark.parametrize("count", [3, 8, 13, 40])
@pytest.mark.parametrize("per_chunk", [1, 4, 7])
@pytest.mark.parametrize("most_rows", [4096, 2 * ROWS])
def test_as_if_merged_afterwards(
    count: int, per_chunk: int, most_rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grouped_blocks, "MOST_ROWS", most_rows)
    for module in (grouped_blocks, least_squares):
        monkeypatch.setattr(module, "MOST_BLOCKS", 8)
    rng = np.random.default_rng(count)
    H, y = rng.normal(size=(count * ROWS, N, P)), rng.normal(size=(count * ROWS, N))
    used = rng.random((count * ROWS, N)) < 0.8
    one_by_one, together = ([Accumulator(P) for _ in range(N)] for _ in "ab")
    for j, joint in enumerate(one_by_one):
        for start in range(0, len(y), ROWS):
            rows = slice(start, start + ROWS)
            joint.add(H[rows, j], y[rows, j], used[rows, j])
    grouped = GroupedBlocks(together)
    grouped.expect(count, ROWS)
    for start in range(0, len(y), per_chunk * ROWS):
        rows = slice(start, start + per_chunk * ROWS)
        chunk = H[rows].copy(), y[rows].copy(), used[rows].copy()
        grouped.add(chunk, list(range(ROWS, len(chunk[1]) + 1, ROWS)))
        chunk[0][:] = np.nan  # its memory is used again
    grouped.expect(0, 0)
    for a, b in zip(one_by_one, together, strict=True):
        assert b.samples == a.samples
        assert b.rows == a.rows
        np.testing.assert_allclose(np.stack(b.blocks), np.stack(a.blocks), atol=1e-12)
