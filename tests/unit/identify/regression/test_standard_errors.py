"""Stated errors are those that seeds show, though residuals and slow noise remember
their past.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from seqid_cli.identify.regression.equations import blocks
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from tests import Array
from tests.plants.sensors import noise

SAMPLES, SEEDS = 2000, 200
TRIAL_SEEDS = 24  # each fits the noise by a search; the studies draw more arms
THETA = np.array([1.0, -2.0, 0.5, 3.0])
GRAVITY = np.array([0.5, -0.2])  # of the trials
TRIALS, ROWS, LENGTH, RATE_HZ = 24, 8, 38, 100.0  # rows of a trial, samples of a row


def coloured(rng: np.random.Generator, pole: float, shape: tuple[int, ...]) -> Array:
    drive = rng.standard_normal(shape)
    drive[1:] *= np.sqrt(1 - pole**2)
    return lfilter([1.0], [1.0, -pole], drive, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_intervals_hold_the_truth_as_often_as_they_say(pole: float) -> None:
    errors = []
    for seed in range(SEEDS):
        rng, joints = (
            np.random.default_rng(seed),
            [Accumulator(len(THETA)) for _ in range(2)],
        )
        for joint, size in zip(joints, (0.3, 1.5), strict=True):
            H = coloured(rng, 0.97, (SAMPLES, len(THETA)))
            y = H @ THETA + size * coloured(rng, pole, (SAMPLES,))
            for block in blocks(SAMPLES, 60.0):
                joint.add(H[block], y[block])
        got = solve(joints)
        errors.append((got.theta - THETA) / np.sqrt(np.diag(got.covariance)))
    assert 0.90 <= float(np.mean(np.abs(errors) < 1.96)) <= 0.99


def trials(seed: int, *, flicker: float, offset: float) -> Rows:
    """Trials one behind the other, forward and back; noise averaged over the rows."""
    rng, count = np.random.default_rng(seed), TRIALS * ROWS
    hiss = noise(rng, count * LENGTH, np.ones(1), coloured=flicker, rate_hz=RATE_HZ)[
        :, 0
    ]
    trial = np.repeat(np.arange(TRIALS), ROWS)
    q = np.linspace(-1.5, 1.5, ROWS)
    path = np.tile(np.concatenate([q, q[::-1]]), TRIALS // 2)
    H = np.column_stack([np.sin(path), np.cos(path)])
    means = hiss.reshape(-1, LENGTH).mean(axis=1)
    return Rows(
        H=H,
        y=H @ GRAVITY + means + offset * rng.standard_normal(TRIALS)[trial],
        t=(np.arange(count) + 0.5) * LENGTH / RATE_HZ,
        weight=np.full(count, float(LENGTH)),
        seconds=np.full(count, LENGTH / RATE_HZ),
        trial=trial,
        log=np.zeros(count, dtype=np.intp),
    )


def standardised(
    H: Array, y: Array, truth: Array, variance: float | None = 1.0
) -> Array:
    """Errors of plain least squares over their stated errors; the variance is that left
    if None.
    """
    cov = np.linalg.inv(H.T @ H)
    theta = cov @ H.T @ y
    left = np.sum((y - H @ theta) ** 2) / (len(y) - len(theta))
    return (theta - truth) / np.sqrt(
        np.diag(cov) * (left if variance is None else variance)
    )


def whitened(rows: Rows, truth: Array) -> Array:
    white = whitener_of(rows)
    return standardised(white(rows.H), white(rows.y), truth)


@pytest.mark.slow
def test_an_offset_that_warms_up_is_no_gravity() -> None:
    # A simulated pendulum of mx 0.039, mz -0.286 kg m; its torque has an offset of up
    # to 0.3 N m.
    with np.load(Path(__file__).parent / "data" / "warming_pendulum.npz") as file:
        rows = Rows(**file)
    assert np.all(np.abs(whitened(rows, np.array([0.039, -0.286]))) < 4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flicker", "offset", "low", "high"),
    [(0.0, 0.0, 0.8, 1.2), (0.6, 0.0, 0.75, 1.3), (0.0, 0.3, 0.75, 1.3)],
    ids=["white", "flicker", "offsets of trials"],
)
def test_averages_of_trials_are_off(
    flicker: float, offset: float, low: float, high: float
) -> None:
    found = [
        trials(seed, flicker=flicker, offset=offset) for seed in range(TRIAL_SEEDS)
    ]
    ours = np.sqrt(np.mean([whitened(rows, GRAVITY) ** 2 for rows in found]))
    white = np.sqrt(
        np.mean([standardised(r.H, r.y, GRAVITY, None) ** 2 for r in found])
    )
    assert low < ours < high
    assert low < white < high if flicker == offset == 0.0 else white > 1.5
