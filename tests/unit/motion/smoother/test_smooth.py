"""The smoother on simulated rigs, against their truth and against the bound of its own model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.motion.imu.sensor import Mounting, link_slopes, link_state
from seqid_cli.motion.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.robot.kinematics import link_motion
from seqid_cli.typing import Array
from tests.plants.fused import Case, Rig, case
from tests.plants.robots.small import random_model
from tests.unit.motion.smoother.bounds import (
    LINES_400,
    bound,
    differentiated,
    from_imus,
    rms,
)

pytestmark = pytest.mark.slow

RIGS = {
    "one": Rig(1, seconds=3.0),
    "one_400": Rig(1, LINES_400, seconds=3.0),
    "two": Rig(2, seconds=3.0),
    "six": Rig(6, seconds=3.0),
}


@cache
def scene(name: str) -> Case:
    """Three seconds of one or two joints at their limits, or of all six."""
    return case(RIGS[name])


@cache
def smoothed(name: str) -> Smoothed:
    s = scene(name)
    return smoothed_motion(s.recording, s.robot, s.stage)


def off_truth(s: Case, got: Smoothed) -> Array:
    """Errors (N, n, 3) of q, dq, ddq."""
    truth = s.log.truth
    true = np.stack([truth.q, truth.dq, truth.ddq], axis=2)
    return np.stack([got.q, got.dq, got.ddq], axis=2) - true


def error_of(s: Case, got: Smoothed) -> Array:
    """RMS errors (n,) of the acceleration."""
    return rms(off_truth(s, got))[:, 2]


@pytest.mark.parametrize(("name", "share"), [("one", 0.05), ("one_400", 0.05), ("two", 0.06)])
def test_coarse_encoders_with_arrays_beat_differentiation_tenfold(name: str, share: float) -> None:
    assert (error_of(scene(name), smoothed(name)) < share * differentiated(scene(name))).all()


@pytest.mark.parametrize("name", RIGS)
def test_both_sources_together_beat_each(name: str) -> None:
    error = error_of(scene(name), smoothed(name))
    assert (error < 0.75 * differentiated(scene(name))).all()
    assert (error < 0.75 * from_imus(scene(name))).all()


@pytest.mark.parametrize("name", RIGS)
def test_errors_stay_near_the_cramer_rao_bound(name: str) -> None:
    """The bound knows noise, mounting, and how large and alike the joints' jerks are as a whole.

    Where jerks are larger for a while, as when friction turns over, the smoother comes below it.
    """
    error = error_of(scene(name), smoothed(name))
    assert (error < 1.3 * bound(scene(name), RIGS[name])).all()


@pytest.mark.parametrize("name", RIGS)
def test_the_variance_is_the_one_seen(name: str) -> None:
    s, got = scene(name), smoothed(name)
    deviation = np.sqrt(got.variance)
    ratio = rms(off_truth(s, got) / deviation)
    assert (ratio > 0.5).all()
    assert (ratio < 1.8).all()


@pytest.mark.parametrize("name", RIGS)
def test_the_place_of_each_imu_is_found(name: str) -> None:
    s, got = scene(name), smoothed(name)
    assert tuple(got.mounted) == tuple(imu.name for imu in s.plant.imus)
    for imu in s.plant.imus:
        # Turning about z alone does not show how far along z an IMU sits.
        known = slice(0, 3 if name == "six" else 2)
        np.testing.assert_allclose(
            got.mounted[imu.name].place.lever[known], imu.lever[known], atol=2e-3
        )


@pytest.mark.parametrize("name", RIGS)
def test_without_imus_it_is_as_good_as_the_best_differentiation(name: str) -> None:
    s = scene(name)
    got = smoothed_motion(s.recording, s.robot, None)
    assert tuple(got.mounted) == ()
    assert (error_of(s, got) < 1.1 * differentiated(scene(name))).all()
    deviation = np.sqrt(got.variance[:, :, 2])
    assert (rms((got.ddq - s.log.truth.ddq) / deviation) < 2.5).all()


def test_a_gap_is_bridged() -> None:
    s = scene("one")
    valid = s.recording.valid.copy()
    valid[1000:1100] = False
    q = s.recording.q.copy()
    q[1000:1100] = 7.0
    got = smoothed_motion(replace(s.recording, valid=valid, q=q), s.robot, s.stage)
    assert error_of(s, smoothed("one"))[0] < 0.5
    off = np.abs(got.ddq - s.log.truth.ddq)[:, 0]
    assert np.sqrt(np.mean(off[200:950] ** 2)) < 0.3
    assert np.sqrt(np.mean(off[1150:-200] ** 2)) < 0.3
    deviation = np.sqrt(got.variance[:, 0, 0])
    assert np.isfinite(deviation).all()


def test_chunks_join_without_a_seam() -> None:
    s, whole = scene("one"), smoothed("one")
    got = smoothed_motion(s.recording, s.robot, s.stage, chunk_s=1.2)
    deviation = np.sqrt(whole.variance[:, :, 2])
    assert rms((got.ddq - whole.ddq) / deviation)[0] < 0.5
    assert np.abs(np.diff(got.q - whole.q, axis=0)).max() < 1e-4
    assert error_of(s, got)[0] < 1.1 * error_of(s, whole)[0]


def test_a_slower_log_is_smoothed_on_finer_knots() -> None:
    """Accelerations jump between samples; what a quarter of the readings tell is not lost."""
    s = scene("two")
    slow = replace(
        s.recording,
        t=s.recording.t[::4],
        q=s.recording.q[::4],
        valid=s.recording.valid[::4],
        health=replace(s.recording.health, rate_hz=250.0),
        accelerometers={name: x[::4] for name, x in s.recording.accelerometers.items()},
    )
    got = smoothed_motion(slow, s.robot, s.stage)
    off = (got.ddq - s.log.truth.ddq[::4])[50:-50]
    assert (np.sqrt(np.mean(off**2, axis=0)) < 1.6 * error_of(s, smoothed("two"))).all()
    deviation = np.sqrt(got.variance[50:-50, :, 2])
    ratio = np.sqrt(np.mean((off / deviation) ** 2, axis=0))
    assert (ratio > 0.5).all()
    assert (ratio < 1.8).all()


def test_readings_and_their_derivatives() -> None:
    """Readings are those of the package's kinematics; derivatives those of differences."""
    rng = np.random.default_rng(0)
    chain = random_model(rng, [False, True, False, False])[1]
    gravity, lever, link = np.array([0.3, -1.0, -9.7]), rng.normal(size=3), 2
    robot = replace(scene("two").robot, chain=chain, gravity=gravity)
    x, turn = rng.normal(size=(3, 4, 5)), Rotation.random(random_state=1)
    axes = np.vstack([rng.normal(size=(5, 3)), np.eye(3)])
    imu = Mounting(link, rng.normal(size=(5, 3)), axes, turn.as_matrix(), lever)

    def value(x: Array, lever: Array, turn: Rotation) -> Array:
        place = replace(imu, lever=lever, R=turn.as_matrix())
        return np.asarray(link_state(robot, link, x) @ place.matrix.T)

    motion = link_motion(chain, gravity, *x)
    R = turn.as_matrix()
    points = lever + imu.positions @ R.T
    force = motion.a[link][:, None] + np.einsum("abn,kb->akn", motion.H[link], points)
    expected = np.einsum("ka,akn->nk", axes[:5] @ R.T, force)
    got = value(x, lever, turn)
    np.testing.assert_allclose(got[:, :5], expected, atol=1e-10)
    np.testing.assert_allclose(got[:, 5:], motion.w[link].T @ R, atol=1e-10)

    state = link_state(robot, link, x)
    by_motion = imu.by_motion(state, link_slopes(robot, link, x))
    seen, by_lever, by_turn = imu.by_place(state)
    np.testing.assert_allclose(np.einsum("nka,ka->nk", seen @ R, axes), got, atol=1e-10)
    step = 1e-6
    for d in range(3):
        for j in range(3):
            change = np.zeros_like(x)
            change[d, j] = step
            slope = (value(x + change, lever, turn) - value(x - change, lever, turn)) / 2 / step
            np.testing.assert_allclose(by_motion[:, :, d, j], slope, atol=1e-6)
    for k, change in enumerate(step * np.eye(3)):
        slope = (value(x, lever + change, turn) - value(x, lever - change, turn)) / 2 / step
        np.testing.assert_allclose(by_lever[:, :, k], slope, atol=1e-6)
        ahead, back = (Rotation.from_rotvec(sign * change) * turn for sign in (1, -1))
        slope = (value(x, lever, ahead) - value(x, lever, back)) / 2 / step
        np.testing.assert_allclose(by_turn[:, :, k], slope, atol=1e-6)
