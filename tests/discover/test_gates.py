"""Gates: how large a gain must be, and that clean logs stay below."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.gates import (
    LEAST,
    LEAST_SMOOTH,
    MARGIN,
    SMOOTH,
    Gates,
)
from seqid_cli.discover.system import LEAST_STEADY, SHARED, Trial
from tests.discover.arms import candidate

FOLDS, ROWS = 10, 20_000


def tried(relative: float, gain: np.ndarray | None = None, rows: int = ROWS) -> Tried:
    gain = np.ones(FOLDS) if gain is None else gain
    trial = Trial(gain, np.ones(FOLDS), 1.0, np.zeros(1), np.eye(1), relative)
    return Tried(candidate("stribeck", 0), {0: np.zeros((rows, 1))}, trial)


def test_the_level_is_what_clean_data_give_with_a_margin_but_not_less_than_a_floor() -> None:
    gates = Gates({"stribeck": LEAST, "spring": 1e-4, SMOOTH: LEAST_SMOOTH})
    assert gates.least("stribeck") == pytest.approx(MARGIN * LEAST)
    assert gates.least("spring") == LEAST
    assert gates.least("payload") == LEAST
    assert gates.least(SMOOTH) == pytest.approx(MARGIN * LEAST_SMOOTH)
    assert Gates().least(SMOOTH) == LEAST_SMOOTH > LEAST


def test_a_negative_gain_on_clean_data_does_not_lower_the_level() -> None:
    assert Gates({"stribeck": -0.5}).least("stribeck") == LEAST


def test_what_passes() -> None:
    gates = Gates({"stribeck": 2 * LEAST})
    level = MARGIN * 2 * LEAST
    assert gates.passes(tried(1.1 * level))
    assert not gates.passes(tried(0.9 * level))
    assert Gates().passes(tried(1.1 * LEAST))
    assert not Gates().passes(tried(0.9 * LEAST))


def test_few_rows_need_more() -> None:
    """The best of many candidates gains by luck as much as it likes where there are few."""
    many, few = tried(2 * LEAST), tried(2 * LEAST, rows=100)
    assert Gates().least_of(many) == LEAST
    assert Gates().passes(many)
    assert Gates().least_of(few) > 2 * LEAST
    assert not Gates().passes(few)


def test_a_gain_of_a_single_fold_does_not_pass() -> None:
    one = np.zeros(FOLDS)
    one[3] = 10.0
    assert tried(0.5, one).trial.steadiness == pytest.approx(1.0)
    assert not Gates().passes(tried(0.5, one))
    assert tried(0.5).trial.steadiness == pytest.approx(np.sqrt(FOLDS))
    two = np.zeros(FOLDS)
    two[[2, 7]] = 5.0
    assert tried(0.5, two).trial.steadiness == pytest.approx(np.sqrt(2))
    assert LEAST_STEADY**2 < 2.0
    assert Gates().passes(tried(0.5, two))


def test_a_large_gain_may_come_from_few_folds() -> None:
    """Of an elastic joint little is seen but in quick moves."""
    uneven = np.full(FOLDS, 0.1)
    uneven[3] = 8.0
    large = tried(0.6, uneven)
    assert 1.1 < large.trial.steadiness < LEAST_STEADY
    assert Gates().passes(large)
    assert not Gates().passes(tried(0.25, uneven))


def test_a_gain_that_few_folds_share_must_be_larger() -> None:
    few = np.zeros(FOLDS)
    few[[2, 7]] = 5.0
    assert Gates().least_of(tried(0.5, few)) == pytest.approx(LEAST * SHARED / 2)
    assert not Gates().passes(tried(0.9 * LEAST * SHARED / 2, few))
    half = np.repeat([0.0, 1.0], FOLDS // 2)
    assert Gates().least_of(tried(0.5, half)) == pytest.approx(LEAST * SHARED / (FOLDS // 2))


def test_noise_is_not_steady() -> None:
    rng = np.random.default_rng(1)
    drawn = [tried(0.5, rng.normal(size=FOLDS)).trial.steadiness for _ in range(400)]
    assert np.mean(np.array(drawn) > LEAST_STEADY) < 0.15
    nothing = tried(0.5, np.zeros(FOLDS))
    assert nothing.trial.steadiness == 0.0
    assert not Gates().passes(replace(nothing))
