"""Samples lost without the stamps showing it: found and put right, and sound logs left
alone.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from seqid_cli.logs.long import open_long
from seqid_cli.logs.lost_samples import Mended, mended
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from tests import Array
from tests.unit.logs.samples import JOINTS, curve, make_robot
from tests.unit.logs.writers import write_parquet

RATES = (100.0, 250.0, 1000.0)
SEEDS = range(4)


def arm(seed: int, rate_hz: float, n: int, *, count: float = 2e-5) -> Stream:
    rng = np.random.default_rng(seed)
    t = np.arange(round(20.0 * rate_hz)) / rate_hz
    w, phase = rng.uniform(0.6, 3.0, (2, n)), rng.uniform(0.0, 6.0, (2, n))
    size = rng.uniform(0.2, 0.6, (2, n)) / w
    warp = t + 0.8 * np.sin(t)  # slow now and then: joints nearly rest
    speed = (1 + 0.8 * np.cos(t))[:, None]
    angle = w[:, None] * warp[None, :, None] + phase[:, None]
    q = np.sum(size[:, None] * np.sin(angle), axis=0)
    dq = speed * np.sum(size[:, None] * w[:, None] * np.cos(angle), axis=0)
    tau = 3.0 * np.sign(dq) + 8.0 * dq + rng.normal(0.0, 0.3, q.shape)
    q = count * np.round((q + rng.normal(0.0, 0.3 * count, q.shape)) / count)
    dq = dq + rng.normal(0.0, 1e-3, q.shape)
    stamps = np.rint(t * 1e9).astype(np.int64)
    return Stream("joints", stamps, {"position": q, "velocity": dq, "tau": tau})


def having(stream: Stream, **channels: Array | None) -> Stream:
    both = (stream.channels | channels).items()
    return replace(
        stream, channels={name: own for name, own in both if own is not None}
    )


def lossy(seed: int, samples: int, *, every: int, gap: int) -> NDArray[np.bool_]:
    """Which samples are left where some are lost again and again,
    at uneven distances.
    """
    rng = np.random.default_rng(100 + seed)
    kept, at = np.ones(samples, np.bool_), every
    while at + gap + 10 < samples:
        kept[at : at + int(rng.integers(max(2, gap // 2), gap + 1))] = False
        at += int(rng.integers(every // 2, 2 * every))
    return kept


def repaired(full: Stream, kept: NDArray[np.bool_]) -> tuple[Mended, NDArray[np.intp]]:
    found = mended(replace(full.take(kept), stamp_ns=full.stamp_ns[: kept.sum()]))
    places = np.flatnonzero(np.diff(np.flatnonzero(kept)) > 1)
    assert set(found.losses.rows) <= set(places)
    return found, places


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("n", [1, 2, 6])
def test_drops_with_even_stamps_are_bridged(
    rate_hz: float, n: int, velocity: bool
) -> None:
    for seed in SEEDS:
        full = arm(seed, rate_hz, n)
        gap = max(6, round(0.03 * rate_hz))
        kept = lossy(seed, len(full), every=round(1.3 * rate_hz), gap=gap)
        found, places = repaired(
            full if velocity else having(full, velocity=None), kept
        )
        sped = np.abs(full.channels["velocity"][kept][places]).max(axis=1) > 0.2
        assert set(places[sped]) <= set(found.losses.rows)
        at, true = found.stream.stamp_ns * 1e-9, full.stamp_ns * 1e-9
        if sped.all():
            assert np.ptp(at[~found.bridged] - true[kept]) < 2.5 / rate_hz
        moments = np.interp(at, at[~found.bridged], true[kept])[found.bridged]
        off = make_interp_spline(true, full.channels["position"], 1)(moments)
        off -= found.stream.channels["position"][found.bridged]
        assert np.sqrt(np.mean(off**2)) < 1e-3


@pytest.mark.parametrize("rate_hz", [250.0, 1000.0])
def test_losses_that_recur_are_found_where_the_joint_turns_back(rate_hz: float) -> None:
    for seed in SEEDS:
        full = arm(seed, rate_hz, 1)
        gap = round(0.04 * rate_hz)
        kept = np.arange(len(full)) % (round(0.1 * rate_hz) + gap) >= gap
        found, places = repaired(full, kept)
        dq = full.channels["velocity"][kept][places, 0]
        # 40 counts
        assert np.isin(places[np.abs(dq) > 0.02], found.losses.rows).mean() > 0.97
        assert np.isin(places, found.losses.rows).mean() > 0.9


KINDS = ("sound", "coarse", "few", "quantised", "differentiated", "true stamps", "held")


def sound_arm(kind: str, seed: int, rate_hz: float, n: int) -> Stream:
    log = arm(seed, rate_hz, n, count={"coarse": 2e-3, "few": 1.6e-2}.get(kind, 2e-5))
    q, dq = log.channels["position"], log.channels["velocity"]
    gap = max(4, round(0.03 * rate_hz))
    kept = lossy(seed, len(log), every=round(2 * rate_hz), gap=gap)
    if kind == "quantised":
        return having(log, velocity=0.02 * np.round(dq / 0.02))
    if kind == "differentiated":
        return having(log, velocity=np.gradient(q, 1.0 / rate_hz, axis=0))
    if kind == "held":  # a position that is held and then catches up
        return having(
            log, position=q[np.maximum.accumulate(np.arange(len(kept)) * kept)]
        )
    return log.take(kept) if kind == "true stamps" else log


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("kind", KINDS)
def test_sound_logs_are_left_alone(rate_hz: float, kind: str, velocity: bool) -> None:
    for seed in range(8):
        for n in (3,) if kind == "held" else (1, 3):
            log = sound_arm(kind, seed, rate_hz, n)
            stream = log if velocity else having(log, velocity=None)
            assert mended(stream).stream is stream


@pytest.mark.parametrize("seed", SEEDS)
def test_a_spike_of_a_coarse_encoder_is_not_a_loss(seed: int) -> None:
    log = arm(seed, 111.0, 1, count=2.0 * np.pi / 600)
    for at in range(200, len(log) - 200, 37):
        q = log.channels["position"].copy()
        q[at] += 0.3
        assert not len(mended(having(log, position=q, velocity=None)).losses.rows)


def released(n: int) -> Stream:
    """Joints that creep on their brakes, step as these let go, creep on, and move."""
    t = np.arange(6000) / 500.0
    creep = 0.012 * t + 0.0012 * (t > 2.0)
    swing = 0.5 * (1.0 - np.cos(3.0 * np.maximum(t - 4.0, 0.0)))
    noise = 5e-6 * np.random.default_rng(3).standard_normal((len(t), n))
    q = (creep + swing)[:, None] * np.linspace(1.0, 0.6, n) + noise
    return Stream("joints", np.rint(1e9 * t).astype(np.int64), {"position": q})


@pytest.mark.parametrize("n", [1, 3])
def test_a_step_as_brakes_let_go_is_no_loss(n: int) -> None:
    log = released(n)
    assert mended(log).stream is log


def test_the_recording_says_it_and_long_logs_are_read_whole(tmp_path: Path) -> None:
    t = np.arange(4000) / 500.0
    kept = (np.arange(4000) < 300) | (np.arange(4000) % 100 > 3)
    true = t[kept]
    q, tau = curve(true, 3), 20.0 * curve(true, 3, 1.0)
    path = write_parquet(
        tmp_path / "log.parquet", t[: len(true)], JOINTS, q, torque=tau
    )
    recording = read_recording(path, make_robot())
    assert any("samples are lost at" in text for text in recording.health.mended)
    assert recording.bridged.sum() == pytest.approx((~kept).sum(), abs=20)
    assert recording.t[-1] == pytest.approx(true[-1], abs=0.05)
    assert np.abs(recording.q - curve(recording.t, 3)).max() < 2e-3
    assert open_long(path, make_robot()) is None
