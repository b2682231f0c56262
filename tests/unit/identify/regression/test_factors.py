"""Factors of blocks, merged, are as good as one least squares over all rows."""

import numpy as np
import pytest

from seqid_cli.identify.regression.least_squares import Accumulator, triangular
from tests import Array

WIDTH, ROWS, BLOCKS = 24, 400, 12


def conditioned(rng: np.random.Generator, condition: float, rows: int, width: int) -> Array:
    """Rows whose columns depend on each other so far."""
    spread = np.logspace(0, -np.log10(condition), width)
    mixing = np.linalg.qr(rng.normal(size=(width, width)))[0]
    return np.asarray(rng.normal(size=(rows, width)) * spread @ mixing)


def accumulated(H: Array, y: Array, rows: int = ROWS) -> Accumulator:
    joint = Accumulator(H.shape[1])
    for start in range(0, len(y), rows):
        joint.add(H[start : start + rows], y[start : start + rows])
    return joint


def solved(R: Array) -> Array:
    return np.asarray(np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=None)[0])


def off(R: Array, rows: Array) -> float:
    """How far R is from the factor of rows, against the largest entry of each column."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    R, rows = R / scale, rows / scale
    return float(np.abs(R.T @ R - rows.T @ rows).max())


@pytest.mark.parametrize("power", range(0, 13, 2))
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_solution_is_as_good_as_lstsqs(power: int, noise: float) -> None:
    rng = np.random.default_rng(power)
    H = conditioned(rng, 10.0**power, ROWS * BLOCKS, WIDTH)
    theta = rng.normal(size=WIDTH)
    y = H @ theta + noise * rng.normal(size=len(H))
    found = accumulated(H, y).total
    exact = np.linalg.lstsq(H, y, rcond=1e-15)[0]
    rows = np.column_stack([H, y])
    by_qr, back = (solved(triangular(each)) for each in (rows, rows[::-1]))
    size = np.linalg.norm(theta)
    if noise == 0.0:
        limit = max(10.0 * np.linalg.norm(exact - theta), 10.0**power * 1e-15 * size)
        assert np.linalg.norm(solved(found) - theta) <= limit
    else:  # what is left of differences between good methods is small against the noise's effect
        apart = max(np.linalg.norm(H @ (exact - each)) for each in (by_qr, back))
        limit = max(3.0 * apart, 1e-9 * noise * np.sqrt(len(H)))
        assert np.linalg.norm(H @ (solved(found) - by_qr)) <= limit
    assert off(found, rows) < 1e-11


@pytest.mark.parametrize("what", ["zero", "same", "sum", "late", "now and then", "nearly"])
def test_columns_that_tell_nothing_new(what: str) -> None:
    rng = np.random.default_rng(4)
    H = rng.normal(size=(ROWS * BLOCKS, WIDTH))
    if what == "zero":
        H[:, [0, 7, WIDTH - 1]] = 0.0
    elif what == "same":
        H[:, 9] = H[:, 4]
    elif what == "sum":
        H[:, 5] = H[:, 1] - 2.0 * H[:, 3]
    elif what == "nearly":
        H[:, 5] = H[:, 1] + 1e-9 * H[:, 5]
    elif what == "late":
        H[: 5 * ROWS, [2, 11]] = 0.0
    else:
        H[np.arange(len(H)) // ROWS % 3 == 1, 6] = 0.0
    y = H @ np.ones(WIDTH) + 1e-3 * rng.normal(size=len(H))
    joint = accumulated(H, y)
    assert off(joint.total, np.column_stack([H, y])) < 1e-12
    for k, block in enumerate(joint.blocks):
        rows = slice(k * ROWS, (k + 1) * ROWS)
        assert off(block, np.column_stack([H[rows], y[rows]])) < 1e-11
        dead = ~H[rows].any(axis=0)
        assert not block[:, :-1][:, dead].any()
        assert not np.tril(block, -1).any()
        assert (np.diag(block) >= 0.0).all()
    expected = np.linalg.lstsq(H, y, rcond=1e-12)[0]
    left = [np.linalg.norm(H @ x - y) for x in (solved(joint.total), expected)]
    assert left[0] == pytest.approx(left[1], rel=1e-9)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e10])
def test_a_huge_row_hides_no_others(size: float) -> None:
    rng = np.random.default_rng(5)
    H = rng.normal(size=(ROWS * BLOCKS, WIDTH))
    H[5 * ROWS + 17] *= size
    y = H @ np.ones(WIDTH) + 1e-3 * rng.normal(size=len(H))
    found, expected = solved(accumulated(H, y).total), np.linalg.lstsq(H, y, rcond=None)[0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15 * size + 1e-12)


def test_what_is_not_a_number_does_not_go_unseen() -> None:
    rng = np.random.default_rng(9)
    H, y = rng.normal(size=(ROWS * 3, WIDTH)), rng.normal(size=ROWS * 3)
    H[ROWS + 5, 3] = np.nan
    assert np.isnan(accumulated(H, y).blocks[1]).any()
