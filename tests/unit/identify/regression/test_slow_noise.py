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


def standardised(rows: Rows, truth: Array = THETA) -> Array:
    white = whitener_of(rows)
    A, y = white(rows.H), white(rows.y)
    cov = np.linalg.inv(A.T @ A)
    return (cov @ A.T @ y - truth) / np.sqrt(np.diag(cov))


def plain(rows: Rows) -> Array:
    cov = np.linalg.inv(rows.H.T @ rows.H)
    theta = cov @ rows.H.T @ rows.y
    left = rows.y - rows.H @ theta
    return (theta - THETA) / np.sqrt(np.diag(cov) * (left @ left) / (len(left) - 2))


def test_an_offset_that_warms_up_is_no_gravity() -> None:
    # A simulated pendulum of mx 0.039, mz -0.286 kg m; its torque has an offset of up to 0.3 N m.
    with np.load(DATA / "warming_pendulum.npz") as file:
        rows = Rows(**file)
    assert np.all(np.abs(standardised(rows, np.array([0.039, -0.286]))) < 4.0)


@pytest.mark.parametrize(
    ("coloured", "offset", "low", "high"),
    [(0.0, 0.0, 0.8, 1.2), (0.6, 0.0, 0.75, 1.3), (0.0, 0.3, 0.75, 1.3)],
    ids=["white", "flicker", "offsets of trials"],
)
def test_errors_are_those_stated(coloured: float, offset: float, low: float, high: float) -> None:
    found = [rows_of(seed, coloured=coloured, offset=offset) for seed in range(60)]
    ours, white = (
        float(np.sqrt(np.mean([errors(rows) ** 2 for rows in found])))
        for errors in (standardised, plain)
    )
    assert low < ours < high
    assert low < white < high if coloured == offset == 0.0 else white > 1.5
