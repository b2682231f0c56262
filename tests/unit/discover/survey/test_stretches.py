"""Stretches: where far more is left than elsewhere, with their edges."""

import numpy as np
import pytest

from seqid_cli.discover.settings import EventSettings
from seqid_cli.discover.survey.stretches import (
    Stretch,
    long_stretches,
    sharpened,
    usual_squares,
)
from tests import Array

SETTINGS = EventSettings()
LOG_S, STEP_S = 48.0, 0.03
T = np.arange(0.0, LOG_S, STEP_S)


def noise(seed: int = 0) -> Array:
    """What is left (M, 2) of two joints; the second one counts half of the time."""
    values = np.random.default_rng(seed).normal(size=(len(T), 2)) * [1.0, 0.1]
    values[np.sin(T) > 0.0, 1] = np.nan
    return values


def pushed(start: float, end: float, height: float, seed: int = 0) -> Array:
    """The same with a push of both joints, whose lever arm changes sign on the way."""
    residual = noise(seed)
    inside = (start <= T) & (end >= T)
    lever = np.cos(np.pi * (T[inside] - start) / (end - start))
    residual[inside] += height * np.outer(lever, [1.0, 0.1])
    return residual


def stretches(residual: Array) -> list[Stretch]:
    (usual,) = usual_squares([residual], [T])
    return [
        sharpened(stretch, residual, T, usual)
        for stretch in long_stretches(residual, T, usual, SETTINGS)
    ]


@pytest.mark.parametrize("seconds", [1.0, 2.0, 3.0, 5.0, 9.0, 14.0, 19.5])
@pytest.mark.parametrize("height", [12.0, 60.0])
def test_a_stretch_is_found_with_its_edges(seconds: float, height: float) -> None:
    for seed in range(5):
        start = 7.0 + 0.4 * seed
        (found,) = stretches(pushed(start, start + seconds, height, seed))
        assert abs(found.start - start) < 0.2
        assert abs(found.end - start - seconds) < 0.2


@pytest.mark.parametrize("height", [12.0, 60.0])
def test_logs_may_be_pushed_for_more_than_half_of_their_time(height: float) -> None:
    """What is usual is what is left beside the pushes."""
    is_log = T < 34.0
    logs = [pushed(7.0, 26.0, height, seed)[is_log] for seed in range(2)]
    usual = usual_squares(logs, [T[is_log]] * 2)
    for residual, of_log in zip(logs, usual, strict=True):
        (found,) = long_stretches(residual, T[is_log], of_log, SETTINGS)
        assert found == pytest.approx((7.0, 26.0), abs=0.4)


def test_a_log_may_be_noisier_than_another() -> None:
    logs = [0.1 * noise(1), pushed(7.0, 12.0, 60.0)]
    quiet, noisy = usual_squares(logs, [T, T])
    assert np.all(noisy > 50.0 * quiet)
    assert long_stretches(logs[0], T, quiet, SETTINGS) == []
    (found,) = long_stretches(logs[1], T, noisy, SETTINGS)
    assert found == pytest.approx((7.0, 12.0), abs=0.4)


def test_noise_has_no_stretch() -> None:
    assert not any(stretches(noise(seed)) for seed in range(50))


@pytest.mark.parametrize(
    ("start", "end"),
    [
        (-1.0, 9.0),  # begins with the log, as what wears off does
        (40.0, 50.0),  # lasts to its end
        (5.0, 27.0),  # lasts too long
    ],
)
def test_what_does_not_begin_and_end_is_no_stretch(start: float, end: float) -> None:
    assert stretches(pushed(start, end, 30.0)) == []


def test_what_comes_often_is_no_stretch() -> None:
    """A law that errs does so at every turn."""
    residual = noise()
    often = np.sin(2 * np.pi * T / 4.0) > 0.6
    residual[often] *= 20.0
    assert stretches(residual) == []


def test_a_joint_of_which_nothing_counts_has_no_usual_square() -> None:
    residual = noise()
    residual[:, 1] = np.nan
    (usual,) = usual_squares([residual], [T])
    assert np.isinf(usual[1])
    assert stretches(residual) == []
