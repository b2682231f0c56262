"""One uniform time base: order, duplicates, gaps, jitter, several clocks."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError, UsageError
from seqid_cli.logs.clocks import tidy
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.timebase import Base, resample
from tests import Array
from tests.unit.logs.samples import JOINTS, curve, grid, make_motion, make_robot
from tests.unit.logs.writers import write_parquet

T0 = 1_700_000_000_000_000_000


def read_times(tmp_path: Path, t: Array, q: Array | None = None) -> Recording:
    path = write_parquet(tmp_path / "log.parquet", t, JOINTS, curve(t, 3) if q is None else q)
    return read_recording(path, make_robot())


def stream(t: Array, values: Array, name: str = "joints") -> Stream:
    return Stream(name, T0 + np.rint(t * 1e9).astype(np.int64), {"position": values})


def test_uniform_samples_are_not_touched(tmp_path: Path) -> None:
    t = grid(500, 300.0) + 17.0
    recording = read_times(tmp_path, t)
    assert not recording.health.resampled
    np.testing.assert_array_equal(recording.q, curve(t, 3))
    np.testing.assert_allclose(recording.t, t - 17.0, atol=1e-8)
    assert recording.health.jitter < 1e-6
    assert recording.health.warnings == ()


def test_jitter_is_interpolated(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t = grid(1000, 200.0) + rng.normal(scale=2e-4, size=1000)
    recording = read_times(tmp_path, t)
    assert recording.health.resampled
    assert recording.health.jitter == pytest.approx(np.std(np.diff(t)) / 0.005, rel=0.02)
    assert recording.rate_hz == pytest.approx(200.0, rel=1e-3)
    np.testing.assert_allclose(recording.q, curve(recording.t + t[0], 3), atol=1e-6)
    assert recording.valid.all()


def test_bursts_are_warned_of(tmp_path: Path) -> None:
    t = np.repeat(grid(100, 20.0), 5) + np.tile(np.arange(5) * 1e-4, 100)
    recording = read_times(tmp_path, t)
    assert recording.health.jitter > 0.5
    assert recording.rate_hz == pytest.approx(100.0, rel=0.02)
    assert recording.valid.all()
    assert np.abs(recording.q).max() <= 1.0  # a spline through bursts would swing


def test_gap_is_bridged_by_a_straight_line_and_marked(tmp_path: Path) -> None:
    t = np.delete(grid(500), slice(200, 240))
    recording = read_times(tmp_path, t)
    np.testing.assert_array_equal(np.flatnonzero(~recording.valid), np.arange(200, 240))
    np.testing.assert_allclose(recording.health.gaps, [(1.99, 2.40)], atol=1e-9)
    ends = curve(np.array([1.99, 2.40]), 3)
    middle = recording.t[200:240]
    for joint in range(3):
        line = np.interp(middle, [1.99, 2.40], ends[:, joint])
        np.testing.assert_allclose(recording.q[200:240, joint], line, atol=1e-9)
    np.testing.assert_allclose(
        recording.q[recording.valid], curve(recording.t[recording.valid], 3), atol=1e-9
    )


@pytest.mark.parametrize("how", ["reversed", "shuffled", "halves", "late", "twice"])
def test_any_order_of_rows_gives_the_same(tmp_path: Path, how: str) -> None:
    t = grid(400)
    q = curve(t, 3)
    orders = {
        "reversed": np.arange(400)[::-1],
        "shuffled": np.random.default_rng(0).permutation(400),
        "halves": np.roll(np.arange(400), 200),
        "late": np.insert(np.delete(np.arange(400), 50), 90, 50),
        "twice": np.tile(np.arange(400), 2),
    }
    recording = read_times(tmp_path, t[orders[how]], q[orders[how]])
    np.testing.assert_array_equal(recording.q, q)
    assert recording.health.non_monotonic > 0
    assert recording.health.duplicates == (400 if how == "twice" else 0)


@pytest.mark.parametrize("back_s", [1.0, 1.003])
def test_clock_that_was_set_back_is_cut(tmp_path: Path, back_s: float) -> None:
    true = grid(600)
    t = np.where(np.arange(600) < 400, true, true - back_s)
    q = curve(true, 3)
    recording = read_times(tmp_path, t, q)
    np.testing.assert_array_equal(recording.q, q[:400])
    assert any("jumps back 1 times (by up to" in w for w in recording.health.warnings)


def test_stamps_far_off_and_a_stuck_clock_are_told(tmp_path: Path) -> None:
    t = grid(300) + 1.7e9
    t[0] = 0.0
    recording = read_times(tmp_path, t)
    assert len(recording.t) == 299
    assert any("longest stretch" in warning for warning in recording.health.warnings)
    stuck = read_times(tmp_path, np.floor(grid(400) * 20.0) / 20.0, curve(grid(400), 3))
    assert any("too coarse" in warning for warning in stuck.health.warnings)


@pytest.mark.parametrize(("count", "rate"), [(19, 10.0), (40, 100.0), (1, 1.0)])
def test_too_short(tmp_path: Path, count: int, rate: float) -> None:
    with pytest.raises(InputError, match=r"at least 20 over 0\.5 s"):
        read_times(tmp_path, grid(count, rate))


def on_base(t: Array, values: Array, rate_hz: float) -> tuple[Array, Array]:
    """Values on a base of another rate over the same time, and its moments."""
    count = int(t[-1] * rate_hz + 1e-6) + 1
    base = Base(T0, 1.0 / rate_hz, count, 0.0, False, np.zeros(0, np.intp), ())
    return resample(stream(t, values), "position", base).values, base.t


def test_bases_of_other_rates() -> None:
    """As of an IMU that is slower or faster than the joints."""
    t = grid(1001, 500.0)
    faster, at = on_base(t, curve(t, 3), 1000.0)
    assert len(at) == 2001
    np.testing.assert_allclose(faster, curve(at, 3), atol=1e-8)
    slower, at = on_base(t, curve(t, 3), 50.0)
    assert len(at) == 101
    # The mean over a window h of sin(w t) is smaller by (w h)^2 / 24.
    np.testing.assert_allclose(slower, curve(at, 3), atol=1.6**2 * 0.02**2 / 24 * 1.1)


def test_coarse_base_does_not_alias() -> None:
    t = grid(5001, 1000.0)
    hum = np.sin(2 * np.pi * 101.0 * t)[:, None] * np.ones(3)
    slower, _ = on_base(t, hum, 100.0)
    assert np.abs(slower[2:-2]).max() < 0.05


def test_absurd_values_count_as_missing(tmp_path: Path) -> None:
    t = grid(300)
    q = curve(t, 3)
    broken = q.copy()
    broken[100, 1], broken[150, 2] = 1e200, np.inf
    recording = read_times(tmp_path, t, broken)
    np.testing.assert_allclose(recording.q, q, atol=1e-6)
    assert any("2 values" in warning for warning in recording.health.warnings)


def test_tidy_merges_rows_that_complement_each_other() -> None:
    nan = np.nan
    values = np.array([[1.0, nan], [nan, 2.0], [3.0, nan], [nan, 4.0], [9.0, nan]])
    done = tidy(stream(np.array([0.0, 0.0, 1.0, 1.0, 1.0]), values))
    np.testing.assert_array_equal(done.stream.channels["position"], [[1.0, 2.0], [3.0, 4.0]])
    assert done.duplicates == 1
    assert done.non_monotonic == 0


def test_unknown_time_source(tmp_path: Path) -> None:
    motion = make_motion(grid())
    path = write_parquet(tmp_path / "a.parquet", motion.t, JOINTS, motion.q)
    with pytest.raises(UsageError, match="publish"):
        read_recording(path, make_robot(), time_source="publish")  # type: ignore[arg-type]
