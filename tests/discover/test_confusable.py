"""Confusable sets and the certainty of a name, on gains made by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.confusable import behind, certainty, rivalries
from seqid_cli.discover.system import Trial
from tests.discover.arms import candidate

LEADER = (10.0, 11.0, 9.0, 10.0)


def trial(gain: Sequence[float]) -> Trial:
    g = np.array(gain)
    return Trial(g, np.full(len(g), 20.0), 1.0, np.zeros(1), np.eye(1), float(g.sum()) / 80.0)


def tried(name: str, gain: Sequence[float], joint: int | None = 0) -> Tried:
    touched = [0, 1] if joint is None else [joint]
    columns = {j: np.zeros((3, 1)) for j in touched}
    return Tried(candidate(name, joint), columns, trial(gain))


def less(shortfall: float, scatter: float) -> list[float]:
    """The leader's gains less a shortfall per fold that scatters."""
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    return [float(x) for x in np.array(LEADER) - shortfall + scatter * signs]


def test_behind_counts_standard_errors_over_the_folds() -> None:
    # Differences 2 -+ 1: sum 8, standard deviation 1.1547, error of the sum 2.309.
    assert behind(trial(LEADER), trial(less(2.0, 1.0))) == pytest.approx(8 / (2 / np.sqrt(3) * 2))
    assert behind(trial(LEADER), trial(less(-2.0, 1.0))) < 0
    assert behind(trial([5.0]), trial([1.0])) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("gain", "confusable"),
    [
        (less(0.1, 0.0), True),  # as good, however surely behind
        (less(2.0, 3.0), True),  # a good part, not surely behind
        (less(2.0, 0.2), False),  # surely behind
        (less(7.0, 9.0), False),  # less than half
    ],
)
def test_who_is_confusable(gain: list[float], confusable: bool) -> None:
    (rival,) = rivalries(tried("stribeck", LEADER), [tried("quadratic_drag", gain)])
    assert rival.confusable is confusable
    assert rival.share == pytest.approx(sum(gain) / sum(LEADER))


def test_only_others_at_the_same_joint_are_rivals() -> None:
    leader = tried("stribeck", LEADER)
    here = tried("quadratic_drag", LEADER)
    elsewhere = tried("stribeck", LEADER, joint=1)
    arm = tried("payload", LEADER, joint=None)
    found = rivalries(leader, [leader, here, elsewhere, arm])
    assert [r.tried.candidate.key for r in found] == [("quadratic_drag", 0), ("payload", None)]


def test_certainty_falls_with_every_rival_that_is_close() -> None:
    leader = tried("stribeck", LEADER)

    def sure(*gains: list[float]) -> float:
        return certainty(rivalries(leader, [tried("spring", g) for g in gains]))

    assert sure() == 1.0
    assert sure(less(5.0, 0.1)) > 0.999
    assert sure(list(LEADER)) == pytest.approx(0.5)
    assert sure(list(LEADER), list(LEADER)) == pytest.approx(1 / 3)
    close, near = sure(less(1.0, 3.0)), sure(less(2.0, 1.0))
    assert 0.5 < close < near < 1.0
    assert sure([-1.0, -2.0, -1.0, 0.0]) == 1.0
