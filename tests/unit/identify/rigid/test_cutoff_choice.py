"""The cut-off by the posterior: the least error of the torque, under a jackknife's
bounds.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.rigid.cutoff_choice import (
    Candidate,
    CutoffChoice,
    choose_cutoff,
)

START = 8.0


def candidate(
    hz: float,
    error: float,
    *,
    rank: int = 2,
    independent: float = 1000.0,
    bias: float = 0.0,
) -> Candidate:
    """What logs tell below a cut-off: two parameters, each with half of the error."""
    return Candidate(
        cutoff_hz=hz,
        theta=np.array([1.0 + bias, 2.0]),
        determined=np.ones(2, dtype=bool),
        covariance=error / 2.0 * np.eye(2),
        moves=np.zeros((10, 2)),
        information=np.eye(2),
        torque_square=100.0,
        rank=rank,
        independent=independent,
    )


def chosen(
    make: Callable[[float], Candidate | None],
    noise: Callable[[float], float] = lambda hz: 0.0,
    highest_hz: float = 64.0,
) -> CutoffChoice:
    return choose_cutoff(
        make, START, lowest_hz=1.0, highest_hz=highest_hz, acceleration_noise=noise
    )


def valley(best_hz: float, depth: float = 1.0) -> Callable[[float], float]:
    """Error with its least at a cut-off, growing by `depth` per octave squared."""
    return lambda hz: float(0.01 * (1.0 + depth * np.log2(hz / best_hz) ** 2))


def test_the_least_error_wins() -> None:
    error = valley(32.0)
    assert chosen(lambda hz: candidate(hz, error(hz))).cutoff_hz == pytest.approx(32.0)
    error = valley(2.0)
    assert chosen(lambda hz: candidate(hz, error(hz))).cutoff_hz == pytest.approx(2.0)


def test_half_an_octave_is_tried_beside_the_best() -> None:
    error = valley(8.0 * np.sqrt(2.0), depth=4.0)
    found = chosen(lambda hz: candidate(hz, error(hz)))
    assert found.cutoff_hz == pytest.approx(8.0 * np.sqrt(2.0))


def test_of_those_nearly_as_good_the_one_nearest_to_the_start_stays() -> None:
    error = valley(32.0, depth=0.02)
    found = chosen(lambda hz: candidate(hz, error(hz)))
    assert found.cutoff_hz == START
    assert found.errors.min() < error(START)


def test_a_cutoff_that_excites_less_is_refused_however_small_its_error() -> None:
    def make(hz: float) -> Candidate:
        return candidate(hz, 0.01 * hz, rank=1 if hz < 4.0 else 2)

    assert chosen(make).cutoff_hz == pytest.approx(4.0)


def test_a_lower_cutoff_needs_several_samples_per_direction() -> None:
    error = valley(2.0)
    assert (
        chosen(lambda hz: candidate(hz, error(hz), independent=hz)).cutoff_hz == START
    )
    error = valley(32.0)
    found = chosen(lambda hz: candidate(hz, error(hz), independent=hz / 10.0))
    assert found.cutoff_hz == pytest.approx(32.0)


def test_a_gain_that_blocks_disagree_on_is_none() -> None:
    error = valley(16.0)

    def make(hz: float) -> Candidate:
        # All the gain is in one block of ten.
        moves = np.zeros((10, 2))
        moves[0, 0] = np.sqrt(error(hz))
        return replace(candidate(hz, error(hz)), moves=moves)

    assert chosen(lambda hz: candidate(hz, error(hz))).cutoff_hz == pytest.approx(16.0)
    assert chosen(make).cutoff_hz == START


def test_noise_in_the_acceleration_bounds_the_cutoff() -> None:
    error = valley(32.0)

    def noise(hz: float) -> float:
        return float(5e-3 * (hz / 17.0) ** 5)

    assert chosen(
        lambda hz: candidate(hz, error(hz)), noise
    ).cutoff_hz == pytest.approx(16.0)
    # Where the start itself has too much of it, a lower one is taken.
    assert (
        chosen(lambda hz: candidate(hz, error(hz)), lambda hz: noise(3 * hz)).cutoff_hz
        < START
    )


def test_parameters_that_agree_with_no_neighbour_are_refused() -> None:
    error = valley(16.0)

    def make(hz: float) -> Candidate:
        # Half a torque unit off, of ten: no noise of ten thousandths explains it.
        return candidate(hz, error(hz), bias=hz / 16.0 if hz > 10.0 else 0.0)

    assert chosen(make, highest_hz=20.0).cutoff_hz == START


def test_logs_that_tell_nothing_keep_the_start() -> None:
    found = chosen(lambda hz: None)
    assert found.cutoff_hz == START
    assert not found.tried
