from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from seqid_cli.discover.noise.whiteness import white
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.unit.discover.drawn_logs import (
    CUTOFF_HZ,
    RATE_HZ,
    low_passed,
    recording,
    resting,
    scenes,
    wander,
)

Case = tuple[Scene, Rows, int]  # scene, rows, samples of the log

DRAWS = 150  # of two joints each
IN_BAND = np.sqrt(2 * CUTOFF_HZ / RATE_HZ)  # RMS of unit white noise after the low-pass


def case(q: Array) -> Case:
    found, rows = scenes([recording(q, np.zeros_like(q))])
    return found[0], rows, len(q)


@pytest.fixture(scope="module")
def moving() -> Case:
    return case(wander(30.0, 1))


def rejected(case: Case, extra: Array, draws: int, seed: int) -> float:
    """Share of residuals, low-passed noise and `extra` (N, 2), that are called coloured."""
    scene, rows, samples = case
    rng = np.random.default_rng(seed)
    count = 0
    for _ in range(draws):
        values = rng.standard_normal((samples, 2)) + extra
        count += int(np.sum(~white(rows, [low_passed(values, scene)])))
    return count / (2 * draws)


def test_low_passed_white_noise_passes_at_the_promised_rate(moving: Case) -> None:
    # 3 of 300 are expected; 11 or more would be seen once in five thousand times.
    assert rejected(moving, np.zeros((moving[2], 2)), DRAWS, 2) <= 10 / 300


def test_rests_between_the_samples_do_not_matter() -> None:
    found = case(resting(30.0, 1.0, 1))
    assert rejected(found, np.zeros((found[2], 2)), DRAWS // 2, 3) <= 7 / 150


@pytest.mark.parametrize("hz", [0.4, 3.0, 6.0])
def test_a_sine_of_half_the_noise_is_seen(moving: Case, hz: float) -> None:
    t = np.arange(moving[2]) / RATE_HZ
    wave = 0.5 * IN_BAND * np.sqrt(2) * np.sin(2 * np.pi * hz * t)
    assert rejected(moving, np.stack([wave, wave], axis=1), 20, 4) > 0.8


def test_slow_noise_of_the_size_of_the_white_is_seen(moving: Case) -> None:
    rng = np.random.default_rng(5)
    slow = lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], rng.standard_normal((moving[2], 2)), axis=0)
    assert rejected(moving, IN_BAND * slow, 20, 6) > 0.8


def test_too_few_samples_are_not_judged() -> None:
    scene, rows, samples = case(wander(3.0, 2))
    line = np.tile(np.sin(np.arange(samples) / RATE_HZ * 2)[:, None], (1, 2))
    assert white(rows, [low_passed(line, scene)]).all()
