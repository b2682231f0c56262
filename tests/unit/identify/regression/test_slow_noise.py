"""Noise of slow trials: rows are white again, whatever its strengths."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from seqid_cli.identify.regression import slow_noise
from seqid_cli.identify.regression.slow_noise import (
    Rows,
    _restricted,
    _root,
    _shapes,
    whitener_of,
)
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


def test_noise_is_common_within_a_log_alone() -> None:
    """Whitened, a row of one log has no part in another log's rows."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1.0, COUNT)
    noise += np.repeat(rng.normal(0.0, 3.0, TRIALS), PER_TRIAL)
    log = np.repeat([0, 1], COUNT // 2)
    of_two_logs = replace(rows(noise, np.ones(COUNT)), log=log)
    whitened = whitener_of(of_two_logs)(np.eye(COUNT))

    is_other = log[:, None] != log[None, :]
    assert not whitened[is_other].any()
    assert np.count_nonzero(whitened) > COUNT


def test_a_long_log_takes_no_more_memory_than_its_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No covariance is of more rows, and rows of different parts stay apart."""
    most = COUNT // 4
    monkeypatch.setattr(slow_noise, "MOST_ROWS", most)
    noise = np.random.default_rng(0).normal(0.0, 1.0, COUNT)
    shuffled = np.random.default_rng(1).permutation(COUNT)
    whole = rows(noise, np.ones(COUNT))
    fields = {name: getattr(whole, name)[shuffled] for name in vars(whole)}
    whitened = whitener_of(Rows(**fields))(np.eye(COUNT))

    part = np.argsort(np.argsort(fields["t"])) // most
    is_other = part[:, None] != part[None, :]
    assert not whitened[is_other].any()
    assert np.count_nonzero(whitened) > COUNT


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


def test_a_torque_that_the_columns_explain_is_no_noise() -> None:
    rng = np.random.default_rng(0)
    weight = np.where(np.arange(COUNT) % 2 == 0, 1.0, 16.0)
    noise = rng.normal(0.0, 1.0, COUNT) / np.sqrt(weight)
    at = rows(noise, weight)
    loaded = replace(at, y=noise + at.H @ (3e5, -2e5))
    white = whitener_of(loaded)(noise[:, None])[:, 0]
    assert np.var(white) == pytest.approx(1.0, rel=0.25)


def test_slow_noise_has_the_power_of_its_frequencies_alone() -> None:
    """F is the integral of cos(2 pi f tau) / f over the frequencies that both rows
    pass.
    """
    t = np.array([0.0, 0.3, 2.0])
    seconds = np.array([0.5, 0.7, 1.1])
    log = Rows(
        H=np.ones((3, 1)),
        y=np.zeros(3),
        t=t,
        weight=np.ones(3),
        seconds=seconds,
        trial=np.arange(3),
        log=np.zeros(3, dtype=np.intp),
    )
    _, _, slow = _shapes(log, np.arange(3))
    lowest = 1.0 / (4.0 * 2.0)  # a quarter of one over the log's length
    for first, second in np.ndindex(3, 3):
        highest = 1.0 / (2.0 * max(seconds[first], seconds[second]))
        lag = t[first] - t[second]
        expected, _ = quad(
            lambda f, lag=lag: np.cos(2 * np.pi * f * lag) / f, lowest, highest
        )
        assert slow[first, second] == pytest.approx(expected, rel=1e-6)


def test_the_covariance_is_the_sum_of_its_three_parts() -> None:
    shape = _shapes(rows(np.zeros(COUNT), np.full(COUNT, 4.0)), np.arange(COUNT))
    white, common, slow = shape
    root = _root(shape, np.array([5.0, 0.2, 0.01]))
    expected = 5.0 * np.diag(white) + 0.2 * common + 0.01 * slow
    np.testing.assert_allclose(root @ root.T, expected, rtol=1e-6, atol=1e-9)


def test_the_likelihood_is_restricted_to_what_the_columns_leave() -> None:
    """By the densities written out; a column that is empty takes nothing away."""
    rng = np.random.default_rng(2)
    every = np.arange(COUNT)
    full = rows(rng.normal(0.0, 1.0, COUNT), np.ones(COUNT))
    H, y = full.H, full.y
    empty = replace(full, H=np.column_stack([H, np.zeros(COUNT)]))
    found, expected = [], []
    for strengths in ((1.0, 0.5, 0.1), (0.3, 2.0, 0.0)):
        root = _root(_shapes(full, every), np.array(strengths))
        V = root @ root.T
        information = H.T @ np.linalg.solve(V, H)
        left = y - H @ np.linalg.solve(information, H.T @ np.linalg.solve(V, y))
        log_determinants = [np.linalg.slogdet(A)[1] for A in (V, information)]
        expected.append(sum(log_determinants) + left @ np.linalg.solve(V, left))
        found.append([_restricted(each, [every], [root]) for each in (full, empty)])
    # A constant is left out.
    np.testing.assert_allclose(
        np.diff(found, axis=0)[0], np.diff(expected)[0], rtol=1e-6
    )


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
