from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.noise.repeats import period_of, repeats_of
from tests.unit.discover.drawn_logs import (
    CUTOFF_HZ,
    PERIOD_S,
    RATE_HZ,
    periodic,
    recording,
    resting,
    scenes,
    wander,
)


def period(q: np.ndarray) -> float | None:
    return period_of(scenes([recording(q, np.zeros_like(q))])[0][0])


@pytest.mark.parametrize("seconds", [2.05 * PERIOD_S, 20.0, 60.0])
def test_period_is_found_to_a_tenth_of_a_sample(seconds: float) -> None:
    found = period(periodic(seconds))
    assert found == pytest.approx(PERIOD_S, abs=0.1 / (24 * CUTOFF_HZ))


def test_encoder_noise_does_not_hide_the_period() -> None:
    q = periodic(30.0) + 2e-3 * np.random.default_rng(0).standard_normal((15000, 2))
    assert period(q) == pytest.approx(PERIOD_S, abs=1 / (24 * CUTOFF_HZ))


def test_rests_around_the_motion_do_not_hide_the_period() -> None:
    q = periodic(20.0)
    still = round(4 * RATE_HZ)
    q = np.concatenate([np.tile(q[:1], (still, 1)), q, np.tile(q[-1:], (still, 1))])
    assert period(q) == pytest.approx(PERIOD_S, abs=1 / (24 * CUTOFF_HZ))


@pytest.mark.parametrize("seed", range(8))
def test_motion_that_does_not_come_back_has_no_period(seed: int) -> None:
    assert period(wander(40.0, seed)) is None
    assert period(resting(40.0, 0.5, seed)) is None


def test_less_than_two_periods_are_none() -> None:
    assert period(periodic(1.9 * PERIOD_S)) is None


def test_a_drift_is_no_repetition() -> None:
    q = periodic(30.0)
    assert period(q + np.linspace(0.0, 1.5, len(q))[:, None]) is None


def test_a_locked_arm_has_no_period() -> None:
    assert period(np.full((5000, 2), 0.3)) is None


def test_repeated_logs_are_paired_with_the_delay_between_them() -> None:
    q = wander(22.0, 1)
    late = round(0.734 * RATE_HZ)
    pair = [q[late:-500], q[: -500 - late], wander(20.0, 2)]
    found = repeats_of(scenes([recording(x, np.zeros_like(x)) for x in pair])[0])
    assert [(r.first, r.second) for r in found] == [(0, 1)]
    assert found[0].lag == pytest.approx(late / RATE_HZ, abs=2e-3)
    assert len(found[0].at) > 0.8 * 19 * 24 * CUTOFF_HZ
