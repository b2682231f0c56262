"""One uniform time base: order, duplicates, gaps, jitter, several clocks."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError, UsageError
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.reading import Reading
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.timebase import Base, resample
from tests import Array
from tests.unit.logs.samples import JOINTS, curve, grid, make_robot
from tests.unit.logs.writers import write_parquet

T0 = 1_700_000_000_000_000_000


def read_times(
    tmp_path: Path, t: Array, q: Array | None = None, **options: Reading
) -> Recording:
    path = write_parquet(
        tmp_path / "log.parquet", t, JOINTS, curve(t, 3) if q is None else q
    )
    return read_recording(path, make_robot(), **options)


def test_uniform_samples_are_not_touched(tmp_path: Path) -> None:
    t = grid(500, 300.0) + 17.0
    recording = read_times(tmp_path, t)
    np.testing.assert_array_equal(recording.q, curve(t, 3))
    np.testing.assert_allclose(recording.t, t - 17.0, atol=1e-8)
    assert recording.health.jitter < 1e-6
    assert (recording.health.resampled, recording.health.warnings) == (False, ())


def test_jitter_is_interpolated_and_bursts_as_well(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t = grid(1000, 200.0) + rng.normal(scale=2e-4, size=1000)
    recording = read_times(tmp_path, t)
    assert recording.health.resampled
    assert recording.health.jitter == pytest.approx(
        np.std(np.diff(t)) / 0.005, rel=0.02
    )
    assert recording.rate_hz == pytest.approx(200.0, rel=1e-3)
    np.testing.assert_allclose(recording.q, curve(recording.t + t[0], 3), atol=1e-6)
    assert recording.valid.all()
    bursts = read_times(
        tmp_path, np.repeat(grid(100, 20.0), 5) + np.tile(np.arange(5) * 1e-4, 100)
    )
    assert bursts.valid.all()
    assert (bursts.rate_hz, bursts.health.jitter > 0.5) == (
        pytest.approx(100.0, rel=0.02),
        True,
    )
    assert np.abs(bursts.q).max() <= 1.0  # a spline through bursts would swing


def test_gap_is_bridged_by_a_straight_line_and_marked(tmp_path: Path) -> None:
    recording = read_times(tmp_path, np.delete(grid(500), slice(200, 240)))
    np.testing.assert_array_equal(np.flatnonzero(~recording.valid), np.arange(200, 240))
    np.testing.assert_allclose(recording.health.gaps, [(1.99, 2.40)], atol=1e-9)
    expected = curve(grid(500), 3)
    expected[200:240] = np.linspace(expected[199], expected[240], 42)[1:-1]
    np.testing.assert_allclose(recording.q, expected, atol=1e-9)


ORDERS = {
    "reversed": np.arange(400)[::-1],
    "shuffled": np.random.default_rng(0).permutation(400),
    "halves": np.roll(np.arange(400), 200),
    "late": np.insert(np.delete(np.arange(400), 50), 90, 50),
    "twice": np.tile(np.arange(400), 2),
}


@pytest.mark.parametrize("how", ORDERS)
def test_any_order_of_rows_gives_the_same(tmp_path: Path, how: str) -> None:
    t, order = grid(400), ORDERS[how]
    recording = read_times(tmp_path, t[order])
    np.testing.assert_array_equal(recording.q, curve(t, 3))
    assert recording.health.non_monotonic > 0
    assert recording.health.duplicates == (400 if how == "twice" else 0)


@pytest.mark.parametrize("back_s", [1.0, 1.003])
def test_clock_that_was_set_back_is_cut(tmp_path: Path, back_s: float) -> None:
    true = grid(600)
    t = np.where(np.arange(600) < 400, true, true - back_s)
    recording = read_times(tmp_path, t, curve(true, 3))
    np.testing.assert_array_equal(recording.q, curve(true, 3)[:400])
    assert any("jumps back 1 times (by up to" in w for w in recording.health.warnings)


def test_stamps_far_off_a_stuck_clock_and_absurd_values_are_told(
    tmp_path: Path,
) -> None:
    t = grid(300) + 1.7e9
    t[0] = 0.0
    recording = read_times(tmp_path, t)
    assert len(recording.t) == 299
    assert any("longest stretch" in warning for warning in recording.health.warnings)
    stuck = read_times(tmp_path, np.floor(grid(400) * 20.0) / 20.0, curve(grid(400), 3))
    assert any("laid evenly" in warning for warning in stuck.health.warnings)
    q = curve(grid(300), 3)
    broken = q.copy()
    broken[100, 1], broken[150, 2] = 1e200, np.inf
    recording = read_times(tmp_path, grid(300), broken)
    np.testing.assert_allclose(recording.q, q, atol=1e-6)
    assert any("2 values" in warning for warning in recording.health.warnings)


@pytest.mark.parametrize(("count", "rate"), [(19, 10.0), (40, 100.0), (1, 1.0)])
def test_too_short(tmp_path: Path, count: int, rate: float) -> None:
    with pytest.raises(InputError, match=r"at least 20 over 0\.5 s"):
        read_times(tmp_path, grid(count, rate))


def test_unknown_time_source(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="publish"):
        read_times(tmp_path, grid(), reading=Reading(time_source="publish"))  # type: ignore[arg-type]


def test_bases_of_other_rates_do_not_alias() -> None:
    def on_base(t: Array, values: Array, rate_hz: float) -> tuple[Array, Array]:
        stream = Stream("imu", T0 + np.rint(t * 1e9).astype(np.int64), {"gyro": values})
        count = int(t[-1] * rate_hz + 1e-6) + 1
        step_s = 1.0 / rate_hz
        base = Base(T0, step_s, count, jitter=0.0, exact=False, gaps=())
        return resample(stream, "gyro", base).values, base.t

    t = grid(1001, 500.0)
    faster, at = on_base(t, curve(t, 3), 1000.0)
    np.testing.assert_allclose(faster, curve(at, 3), atol=1e-8)
    slower, at = on_base(t, curve(t, 3), 50.0)
    # The mean over a window h of sin(w t) is smaller by (w h)^2 / 24.
    np.testing.assert_allclose(slower, curve(at, 3), atol=1.6**2 * 0.02**2 / 24 * 1.1)
    t = grid(5001, 1000.0)
    hum = np.sin(2 * np.pi * 101.0 * t)[:, None] * np.ones(3)
    assert np.abs(on_base(t, hum, 100.0)[0][2:-2]).max() < 0.05
