"""Noise of slow trials: rows are white again, whatever its strengths."""

import numpy as np
import pytest

from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from seqid_cli.typing import Array

TRIALS, PER_TRIAL = 24, 8
COUNT = TRIALS * PER_TRIAL


def rows(noise: Array, weight: Array) -> Rows:
    """Rows of one log, a trial every 20 s, whose mean torque is asked for."""
    trial = np.repeat(np.arange(TRIALS), PER_TRIAL)
    q = np.linspace(-1.0, 1.0, COUNT)
    return Rows(
        H=np.column_stack([np.ones(COUNT), np.cos(40.0 * q)]),
        y=noise,
        t=20.0 * trial + np.tile(np.arange(PER_TRIAL), TRIALS).astype(np.float64),
        weight=weight,
        seconds=np.full(COUNT, 1.0),
        trial=trial,
        log=np.zeros(COUNT, dtype=np.intp),
    )


def white_variances(noise: Array, weight: Array) -> Array:
    """Return the variance of whitened rows, and that of sums over a trial's rows."""
    white = whitener_of(rows(noise, weight))(noise[:, None])[:, 0]
    sums = white.reshape(TRIALS, PER_TRIAL).sum(axis=1) / np.sqrt(PER_TRIAL)
    return np.array([np.var(white), np.var(sums)])


@pytest.mark.slow
@pytest.mark.parametrize("common", [0.0, 0.5, 3.0])
def test_what_is_common_to_a_trial_is_taken_out(common: float) -> None:
    """Of rows that are white, sums have the variance of the rows."""
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, 1.0, COUNT)
        noise += np.repeat(rng.normal(0.0, common, TRIALS), PER_TRIAL)
        found.append(white_variances(noise, np.ones(COUNT)))
    of_rows, of_sums = np.mean(found, axis=0)
    assert of_rows == pytest.approx(1.0, rel=0.25)
    assert of_sums == pytest.approx(of_rows, rel=0.4)


def test_rows_of_more_samples_have_less_noise() -> None:
    rng = np.random.default_rng(0)
    weight = np.where(np.arange(COUNT) % 2 == 0, 1.0, 16.0)
    noise = rng.normal(0.0, 1.0, COUNT) / np.sqrt(weight)
    white = whitener_of(rows(noise, weight))(noise[:, None])[:, 0]
    light, heavy = np.var(white[::2]), np.var(white[1::2])
    assert heavy == pytest.approx(light, rel=0.4)


def test_the_scale_of_the_noise_is_found() -> None:
    """Whitened rows have unit variance, however large the noise is."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1.0, COUNT)
    small, large = (white_variances(x * noise, np.ones(COUNT)) for x in (1e-3, 50.0))
    np.testing.assert_allclose(small, large, rtol=0.1)
    assert small[0] == pytest.approx(1.0, rel=0.25)


def test_slow_noise_weighs_on_the_mean() -> None:
    """The error that is stated of a mean is that which 1/f noise makes of it."""
    errors, stated = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        spectrum = np.fft.rfft(rng.normal(0.0, 1.0, 4 * 20 * TRIALS))
        frequency = np.arange(len(spectrum))
        slow = np.fft.irfft(spectrum / np.sqrt(np.maximum(frequency, 1)))
        slow *= 2.0 / np.std(slow)
        at = rows(np.zeros(COUNT), np.ones(COUNT))
        noise = slow[at.t.astype(int)] + rng.normal(0.0, 0.3, COUNT)
        whiten = whitener_of(rows(noise, np.ones(COUNT)))
        H, y = whiten(at.H), whiten(noise[:, None])[:, 0]
        errors.append(np.linalg.lstsq(H, y)[0][0])
        stated.append(np.sqrt(np.linalg.inv(H.T @ H)[0, 0]))
    ratio = np.sqrt(np.mean(np.square(errors))) / np.mean(stated)
    assert 0.5 < ratio < 2.0
