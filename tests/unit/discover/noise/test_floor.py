from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.noise.floor import NoiseFloor, noise_floor, rms
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.robot.types import Joint
from tests import Array
from tests.plants.sensors import noise, quantise
from tests.unit.discover.drawn_logs import (
    RATE_HZ,
    low_passed,
    recording,
    resting,
    scenes,
    smooth_torque,
    wander,
)

STD = np.array([1.0, 0.3])  # N m, of the raw torque
LOOSE = 3.0  # what the residual is larger by than noise


def silent(found: list[Scene]) -> list[Array]:
    """What encoders without noise make of the torque."""
    return [np.zeros_like(scene.motion.q) for scene in found]


def ratio(
    logs: list[Array], *, coloured: float, step: float, seed: int, hunting: float = 0.0
) -> tuple[Array, NoiseFloor]:
    """Floor over the true RMS of low-passed noise (n,); torque hunts at rest by so much of it."""
    rng = np.random.default_rng(seed)
    signal = [smooth_torque(q) + hunting * _hunted(q) for q in logs]
    raw = [noise(rng, len(q), STD, coloured=coloured, rate_hz=RATE_HZ) for q in logs]
    total = [quantise(s + e, step * STD) for s, e in zip(signal, raw, strict=True)]
    recordings = [recording(q, tau) for q, tau in zip(logs, total, strict=True)]
    found, rows = scenes(recordings)
    left = [low_passed(t - s, x) for t, s, x in zip(total, signal, found, strict=True)]
    truth = np.array([rms(rows.of(j, [r[:, j] for r in left])) for j in range(2)])
    # What a model of the motion misses repeats with it, and so is above the floor.
    missed = [np.cos(3 * x.motion.q) for x in found]
    scale = LOOSE * truth
    given = [r + scale * m for r, m in zip(left, missed, strict=True)]
    floor = noise_floor(recordings, found, given, silent(found), rows=rows)
    return floor.rms / truth, floor


def _hunted(q: Array) -> Array:
    """Torque (N, 2) N m of a controller that goes to and fro while all joints stand."""
    still = np.all(np.gradient(q, axis=0) == 0.0, axis=1)
    saw = np.cumsum(np.sign(np.sin(np.arange(len(q)) / 40.0))) / 40.0
    return np.asarray(STD * (still * saw)[:, None])


@pytest.mark.parametrize(("coloured", "step"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.5)])
def test_rests_give_the_noise_on_average(coloured: float, step: float) -> None:
    drawn = [ratio([resting(80.0, 6.0, s)], coloured=coloured, step=step, seed=s) for s in range(4)]
    assert all(floor.ways == ("rests", "rests") for _, floor in drawn)
    assert abs(np.mean([found for found, _ in drawn]) - 1.0) < 0.15


def test_white_noise_shows_above_the_cutoff_of_any_motion() -> None:
    found, floor = ratio([wander(60.0, 4)], coloured=0.0, step=0.0, seed=4)
    assert floor.ways == ("spectrum", "spectrum")
    np.testing.assert_allclose(found, 1.0, atol=0.15)


def test_flicker_that_shows_above_the_cutoff_goes_on_below_it() -> None:
    found, floor = ratio([wander(60.0, 4)], coloured=0.5, step=0.0, seed=4)
    assert floor.ways == ("spectrum", "spectrum")
    np.testing.assert_allclose(found, 1.0, atol=0.35)
    np.testing.assert_array_less(floor.low / floor.rms * found, 1.0)
    np.testing.assert_array_less(1.0, floor.high / floor.rms * found)


def test_the_residual_does_not_bound_the_floor() -> None:
    q = wander(30.0, 6)
    tau = np.random.default_rng(0).standard_normal(q.shape)
    log = recording(q, tau)
    found, rows = scenes([log])
    left = low_passed(tau, found[0])
    slow = Lowpass(1.5, found[0].motion.rate_hz)
    small = [left - slow(left)]
    floor = noise_floor([log], found, small, silent(found), rows=rows)
    truth = np.array([rms(rows.of(j, [left[:, j]])) for j in range(2)])
    result = np.array([rms(rows.of(j, [small[0][:, j]])) for j in range(2)])
    assert np.all(result < 0.95 * truth)
    np.testing.assert_allclose(floor.rms, truth, rtol=0.2)
    assert np.all(floor.low < truth)
    assert np.all(floor.high > truth)


def test_less_than_the_interval_makes_the_floor_doubtful() -> None:
    floor = NoiseFloor(np.full(3, 2.0), np.full(3, 1.5), np.full(3, 3.0), ("rests",) * 3)
    arm = (Joint("lift", prismatic=True), Joint("knee"), Joint("foot"))
    (note,) = floor.doubts(np.array([1.4, 1.6, np.nan]), arm)
    assert note.startswith("joint lift: 1.4 N is left")
    assert "1.5 to 3 N:" in note


def test_a_controller_that_hunts_at_rest_is_no_noise() -> None:
    """Held at a count's edge a joint's torque goes to and fro; in motion it does not."""
    q = resting(80.0, 6.0, 6)
    quiet, floor = ratio([q], coloured=0.0, step=0.0, seed=6)
    assert floor.ways == ("rests", "rests")
    hunted, told = ratio([q], coloured=0.0, step=0.0, seed=6, hunting=30.0)
    assert told.ways[0] == "spectrum"
    np.testing.assert_allclose(hunted, 1.0, atol=0.4)
    np.testing.assert_allclose(quiet, 1.0, atol=0.3)
