"""From a recording to joint motion: filtered alike, decimated without loss, gaps kept out."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r
from tests.plants.sensors import quantise

RATE = 500.0
STEP = 2 * np.pi / 2**14


@pytest.fixture(scope="module")
def robot() -> Robot:
    return planar_2r()


def curves(samples: int = 6000) -> tuple[Array, Array, Array, Array]:
    """Times, positions, velocities and accelerations of two joints."""
    t = np.arange(samples) / RATE
    w, phase = np.array([2.0, 3.1]), np.array([0.3, 1.0])
    angle = t[:, None] * w + phase
    return t, np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)


def recording(q: Array, tau: Array | None = None) -> Recording:
    return made_recording(q, tau, rate_hz=RATE)


def test_velocity_and_acceleration_are_the_true_ones(robot: Robot) -> None:
    _, q, dq, ddq = curves()
    motion = estimate_motion(recording(quantise(q, STEP)), robot, MotionOptions())
    own = motion.usable
    assert own.sum() > 0.8 * len(q)
    assert np.sqrt(np.mean((motion.dq - dq)[own] ** 2)) < 0.005
    allowed = 2 * motion.cutoff.acceleration_noise + 0.01 * np.abs(ddq).max(axis=0)
    assert (np.sqrt(np.mean((motion.ddq - ddq)[own] ** 2, axis=0)) < allowed).all()


def test_parallel_filtering_keeps_a_linear_equation_exact(robot: Robot) -> None:
    """With tau = a q + b ddq + c the filtered sides agree, whatever the cut-off."""
    _, q, _, _ = curves(3000)
    q = q + 0.05 * np.random.default_rng(0).standard_normal(q.shape)
    tau = 3.0 * q + 0.7
    for hz in (2.0, 8.0, 30.0):
        motion = estimate_motion(recording(q, tau), robot, MotionOptions(cutoff_hz=hz))
        assert motion.tau is not None
        model = motion.filtered(3.0 * motion.q + 0.7)
        np.testing.assert_allclose(motion.tau, model, atol=1e-9)
        np.testing.assert_allclose(motion.filtered(tau, times=2), motion.tau, atol=1e-12)


def test_samples_near_ends_and_gaps_are_not_usable(robot: Robot) -> None:
    _, q, _, _ = curves()
    log = recording(q)
    valid = log.valid.copy()
    valid[3000:3010] = False
    motion = estimate_motion(replace(log, valid=valid), robot, MotionOptions(cutoff_hz=10.0))
    margin = 2 * motion.lowpass.settling
    expected = np.zeros(len(q), dtype=bool)
    expected[margin : 3000 - margin] = True
    expected[3010 + margin : len(q) - margin] = True
    np.testing.assert_array_equal(motion.usable, expected)


def test_a_log_of_gaps_is_refused(robot: Robot) -> None:
    log = recording(curves(2000)[1])
    valid = np.arange(2000) % 50 != 0
    with pytest.raises(InputError, match="long enough for a low-pass of 5 Hz") as caught:
        estimate_motion(replace(log, valid=valid), robot, MotionOptions(cutoff_hz=5.0))
    assert "log.parquet" in str(caught.value)


def test_a_sample_next_to_a_dropped_gap_is_invalid(robot: Robot) -> None:
    log = recording(curves()[1])
    valid = log.valid.copy()
    valid[3003] = False  # between two kept samples
    motion = estimate_motion(replace(log, valid=valid), robot, MotionOptions(cutoff_hz=5.0))
    short = decimated(motion)
    assert not short.valid[300]
    assert short.valid[[299, 301]].all()
