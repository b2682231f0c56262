"""Roots of precisions by their parts, against the matrix as a whole."""

import numpy as np
import pytest

from seqid_cli.discover.select import arrow
from seqid_cli.discover.select.algebra import RIDGE
from seqid_cli.discover.select.arrow import Layout
from tests import Array

# A shared group of 3, two with channels of their own, one that meets the first of these
WHERE = [slice(0, 3), slice(3, 8), slice(8, 12), slice(12, 14)]
CHANNELS = [[0, 1], [0], [1], [0]]


@pytest.fixture
def layout(monkeypatch: pytest.MonkeyPatch) -> Layout:
    monkeypatch.setattr(arrow, "FEWEST", 4)
    return Layout.of(WHERE, CHANNELS, [True] * 4)


def drawn_precision(seed: int = 0) -> Array:
    """A precision of rows of two channels: groups 1 and 2 do not meet."""
    rng = np.random.default_rng(seed)
    M = np.eye(14)
    for channel in (0, 1):
        rows = np.zeros((30, 14))
        for at, of_group in zip(WHERE, CHANNELS, strict=True):
            if channel in of_group:
                rows[:, at] = rng.standard_normal((30, at.stop - at.start))
        M += rows.T @ rows
    return M


def test_groups_without_a_common_channel_have_roots_of_their_own(
    layout: Layout,
) -> None:
    assert layout.own == (WHERE[1], WHERE[2])
    np.testing.assert_array_equal(layout.shared, [0, 1, 2, 12, 13])


def test_what_a_prior_ties_or_is_small_is_shared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arrow, "FEWEST", 4)
    tied = Layout.of(WHERE, CHANNELS, [True, False, True, True])
    assert tied.own == (WHERE[2],)
    monkeypatch.setattr(arrow, "FEWEST", 6)
    small = Layout.of(WHERE, CHANNELS, [True] * 4)
    assert small.own == ()
    np.testing.assert_array_equal(small.shared, np.arange(14))


def test_solutions_are_those_of_the_whole_matrix(layout: Layout) -> None:
    M = drawn_precision()
    right = np.random.default_rng(1).standard_normal((14, 5))
    right[WHERE[1], 2] = 0.0  # a column that one of the groups has nothing of
    right[WHERE[2], :3] = 0.0
    factor = layout.arrow(M).factored()
    ridged = M + RIDGE * np.eye(14)
    np.testing.assert_allclose(factor.solved(right), np.linalg.solve(ridged, right))
    half = factor.halved(right)
    expected = right.T @ np.linalg.solve(ridged, right)
    np.testing.assert_allclose(half.T @ half, expected, rtol=1e-9, atol=1e-12)
    log_det = np.linalg.slogdet(ridged)[1]
    assert factor.half_log_det == pytest.approx(0.5 * log_det, rel=1e-12)


@pytest.mark.parametrize("channel", [0, 1])
def test_products_of_one_channel_are_added_where_they_belong(
    layout: Layout, channel: int
) -> None:
    M = drawn_precision()
    index = np.concatenate(
        [
            np.arange(at.start, at.stop)
            for at, of_group in zip(WHERE, CHANNELS, strict=True)
            if channel in of_group
        ]
    )
    change = drawn_precision(2)[np.ix_(index, index)]
    parts = layout.arrow(M)
    changed = parts.copy()
    changed.add(layout.place(index), change)
    M_changed = M.copy()
    M_changed[np.ix_(index, index)] += change
    right = np.eye(14)
    for arrow_of, matrix in ((parts, M), (changed, M_changed)):
        expected = np.linalg.inv(matrix + RIDGE * np.eye(14))
        np.testing.assert_allclose(
            arrow_of.factored().solved(right), expected, rtol=1e-8, atol=1e-12
        )
