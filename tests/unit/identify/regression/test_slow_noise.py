"""Standard errors of trials' averages hold though the noise is slow."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.regression.slow_noise import Rows, whitener_of
from tests import Array
from tests.plants.sensors import noise

pytestmark = pytest.mark.slow


DATA = Path(__file__).parent / "data"
THETA = np.array([0.5, -0.2])
RATE, SECONDS, TRIALS, ROWS = 100.0, 3.0, 24, 8


def rows_of(seed: int, *, coloured: float, offset: float) -> Rows:
    """Trials one behind the other, forward and back; noise averaged over the rows."""
    rng = np.random.default_rng(seed)
    length = round(SECONDS * RATE / ROWS)
    hiss = noise(rng, TRIALS * ROWS * length, np.ones(1), coloured=coloured, rate_hz=RATE)[:, 0]
    means = hiss.reshape(-1, length).mean(axis=1)
    trial = np.repeat(np.arange(TRIALS), ROWS)
    q = np.linspace(-1.5, 1.5, ROWS)
    path = np.concatenate([q if k % 2 == 0 else q[::-1] for k in range(TRIALS)])
    H = np.column_stack([np.sin(path), np.cos(path)])
    count = len(trial)
    return Rows(
        H=H,
        y=H @ THETA + means + offset * rng.standard_normal(TRIALS)[trial],
        t=(np.arange(count) + 0.5) * length / RATE,
        weight=np.full(count, float(length)),
        seconds=np.full(count, length / RATE),
        trial=trial,
        log=np.zeros(count, dtype=np.intp),
    )


def standardised(rows: Rows) -> Array:
    white = whitener_of(rows)
    A, y = white(rows.H), white(rows.y)
    cov = np.linalg.inv(A.T @ A)
    return (cov @ A.T @ y - THETA) / np.sqrt(np.diag(cov))


def plain(rows: Rows) -> Array:
    cov = np.linalg.inv(rows.H.T @ rows.H)
    theta = cov @ rows.H.T @ rows.y
    left = rows.y - rows.H @ theta
    return (theta - THETA) / np.sqrt(np.diag(cov) * (left @ left) / (len(left) - 2))


def rms_z(coloured: float, offset: float) -> tuple[float, float]:
    found = [rows_of(seed, coloured=coloured, offset=offset) for seed in range(60)]
    ours = np.array([standardised(rows) for rows in found])
    white = np.array([plain(rows) for rows in found])
    return float(np.sqrt(np.mean(ours**2))), float(np.sqrt(np.mean(white**2)))


def test_an_offset_that_warms_up_is_no_gravity() -> None:
    # A simulated pendulum of mx 0.039, mz -0.286 kg m; its torque has an offset of up to 0.3 N m.
    with np.load(DATA / "warming_pendulum.npz") as file:
        rows = Rows(**file)
    white, truth = whitener_of(rows), np.array([0.039, -0.286])
    A, y = white(rows.H), white(rows.y)
    cov = np.linalg.inv(A.T @ A)
    assert np.all(np.abs(cov @ A.T @ y - truth) < 4.0 * np.sqrt(np.diag(cov)))


def test_white_noise_stays_white() -> None:
    ours, white = rms_z(0.0, 0.0)
    assert 0.8 < ours < 1.2
    assert 0.8 < white < 1.2


def test_flicker_noise_is_allowed_for() -> None:
    ours, white = rms_z(0.6, 0.0)
    assert 0.75 < ours < 1.3
    assert white > 1.5


def test_offsets_of_trials_are_allowed_for() -> None:
    ours, white = rms_z(0.0, 0.3)
    assert 0.75 < ours < 1.3
    assert white > 1.5
