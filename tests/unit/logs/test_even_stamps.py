"""Stamps coarser than an even count of samples are laid evenly, right ones are kept."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.logs.even_stamps import evened
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from tests import Array
from tests.unit.logs.samples import JOINTS, curve, grid, make_robot
from tests.unit.logs.writers import write_parquet

SAMPLES = 1500
RNG = np.random.default_rng(4)


def floored(t: Array, step_s: float) -> Array:
    return np.floor(t / step_s) * step_s


def in_bursts(t: Array, size: int) -> Array:
    """Stamps of a reader that empties its buffer once it holds `size` samples."""
    burst = np.arange(len(t)) // size
    last = np.minimum((burst + 1) * size - 1, len(t) - 1)
    return np.asarray(t[last] + 1e-4 * (np.arange(len(t)) % size))


def stream(t: Array, stamps: Array, noise: float = 2e-5) -> Stream:
    """Joints that move, as a fine encoder reads them at times `t` [s]."""
    q = curve(t, 3) + noise * np.random.default_rng(1).standard_normal((len(t), 3))
    return Stream("joints", np.rint(1e9 * stamps).astype(np.int64), {"position": q})


@pytest.mark.parametrize("rate_hz", [30.0, 50.0, 100.0, 250.0, 1000.0])
def test_stamps_of_a_system_timer_are_laid_evenly(rate_hz: float) -> None:
    t = grid(SAMPLES, rate_hz)
    even = evened(stream(t, floored(t, 1.0 / 64.0)))
    assert even is not None
    off = 1e-9 * even.stream.stamp_ns - t
    assert np.std(off) < 5e-4
    assert "15.6 ms" in even.warning or rate_hz < 64.0


@pytest.mark.parametrize("size", [5, 8, 30])
def test_bursts_of_even_samples_are_laid_evenly(size: int) -> None:
    t = grid(SAMPLES, 100.0)
    even = evened(stream(t, in_bursts(t, size)))
    assert even is not None
    assert np.std(1e-9 * even.stream.stamp_ns - t) < 2.5e-3
    assert (np.diff(even.stream.stamp_ns) > 0).all()


def test_a_gap_stays_where_it_is() -> None:
    t = grid(SAMPLES, 100.0)
    t[700:] += 2.0
    even = evened(stream(t, floored(t, 1.0 / 64.0)))
    assert even is not None
    np.testing.assert_allclose(1e-9 * even.stream.stamp_ns - t, -0.0078, atol=2e-3)


def true_times(kind: str) -> Array:
    """Uneven times at which samples were really taken."""
    t = grid(SAMPLES, 100.0)
    if kind == "bursts":
        return in_bursts(t, 8)
    if kind == "jitter":
        return np.sort(t + 2e-3 * RNG.standard_normal(SAMPLES))
    return np.cumsum(RNG.exponential(0.01, SAMPLES))


@pytest.mark.parametrize("kind", ["bursts", "jitter", "waits"])
def test_uneven_samples_keep_their_stamps(kind: str) -> None:
    t = true_times(kind)
    assert evened(stream(t, t)) is None


def test_messages_sent_twice_are_not_laid_apart() -> None:
    t = np.repeat(grid(SAMPLES // 2), 2)
    assert evened(stream(t, t, noise=0.0)) is None


def test_samples_that_share_stamps_are_apart_where_nothing_moves() -> None:
    t = grid(SAMPLES, 250.0)
    still = stream(0.0 * t, floored(t, 1.0 / 64.0))
    even = evened(still)
    assert even is not None
    assert np.std(1e-9 * even.stream.stamp_ns - t) < 5e-4


def test_the_log_is_read_whole_and_says_so(tmp_path: Path) -> None:
    t = grid(SAMPLES, 250.0)
    path = write_parquet(
        tmp_path / "log.parquet",
        floored(t, 1.0 / 64.0),
        JOINTS,
        curve(t, 3),
        torque=20.0 * curve(t, 3, 1.0),
    )
    recording = read_recording(path, make_robot())
    assert recording.rate_hz == pytest.approx(250.0, rel=1e-3)
    assert recording.health.duplicates == 0
    assert np.abs(recording.q - curve(recording.t, 3)).max() < 1e-3
    codes = {finding.code for finding in inspect_log(path).findings}
    assert "stamps_coarse" in codes
    assert "stamps_repeated" not in codes
