"""Reversals whitened together, against one after the other."""

import numpy as np

from seqid_cli.discover.survey.reversals import Reversal, Whitening
from tests import Array

ROWS = 60


def drawn_reversals() -> list[Reversal]:
    """In the order of time: some share rows, one is long, one reaches the last row."""
    rng = np.random.default_rng(0)
    places = [(0, 5, 2), (3, 7, 3), (8, 2, 1), (20, 30, 2), (24, 6, 2), (55, 5, 4)]
    return [Reversal.of(first, rng.standard_normal((m, k))) for first, m, k in places]


def one_by_one(reversals: list[Reversal], values: Array) -> Array:
    result = values.copy()
    for reversal in reversals:
        of_reversal = slice(reversal.first, reversal.first + len(reversal.directions))
        D = reversal.directions
        shrunk = np.eye(len(D)) - (D * reversal.shrinkage) @ D.T
        result[of_reversal] = shrunk @ result[of_reversal]
    return result


def test_all_together_are_one_after_the_other() -> None:
    reversals = drawn_reversals()
    values = np.random.default_rng(1).standard_normal((ROWS, 3))
    whitened = values.copy()
    whitening = Whitening.of(reversals, ROWS)
    whitening.whiten(whitened)
    np.testing.assert_allclose(whitened, one_by_one(reversals, values), atol=1e-12)
    assert len(whitening.layers) < len(reversals)


def test_rows_without_a_reversal_stay() -> None:
    values = np.ones((ROWS, 1))
    whitened = values.copy()
    Whitening.of([], ROWS).whiten(whitened)
    np.testing.assert_array_equal(whitened, values)
