"""The smoother with IMUs, clocks and geometry that are not as they should be."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.motion.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.typing import Array
from tests.plants.fused import Case, Fault, Rig, case
from tests.unit.motion.smoother.bounds import SETTLED, rms

pytestmark = pytest.mark.slow
COARSE = 600  # counts per turn
EVERYTHING = Fault(bias=0.2, drift=0.05, gain=0.01, tilt_deg=0.5, delay_s=0.0203)


@cache
def recorded(rig: Rig) -> Case:
    return case(rig)


@cache
def fused(rig: Rig) -> Smoothed:
    c = recorded(rig)
    return smoothed_motion(c.recording, c.robot, c.stage)


@cache
def alone(rig: Rig) -> Array:
    """RMS errors (n,) rad/s^2 of the encoders alone."""
    c = recorded(rig)
    return rms(smoothed_motion(c.recording, c.robot, None).ddq - c.truth)


def error(rig: Rig) -> Array:
    return rms(fused(rig).ddq - recorded(rig).truth)


def coverage(rig: Rig) -> Array:
    """RMS of errors over their standard errors, (n,)."""
    got = fused(rig)
    return rms((got.ddq - recorded(rig).truth) / np.sqrt(got.variance[:, :, 2]))


@pytest.mark.parametrize("late", [0.002, 0.02, -0.0137])
@pytest.mark.parametrize("joints", [1, 2])
def test_a_late_clock_is_found(joints: int, late: float) -> None:
    right = Rig(joints, COARSE)
    off = replace(right, fault=Fault(delay_s=late))
    for name, found in fused(off).mounted.items():
        assert abs(found.delay - late) < 1e-4, name
    # Between samples, where accelerations jump, readings tell less.
    assert (error(off) < 2.0 * error(right)).all()
    assert (error(off) < 0.1 * alone(right)).all()


def test_the_offset_of_a_calibration_counts_where_the_log_tells_nothing() -> None:
    c = recorded(Rig(1, COARSE, fault=Fault(delay_s=0.004)))
    own = c.stage.imus["imu_a"]
    known = ImuCalibration(
        rotation=own.rotation,
        std_error_deg=own.std_error_deg,
        time_offset_s=0.004,
        time_offset_std_error_s=1e-5,
    )
    still = replace(
        c.recording,
        q=np.zeros_like(c.recording.q),
        accelerometers={
            "imu_a": 0.03 * np.random.default_rng(0).standard_normal((len(c.truth), 12))
        },
    )
    robot = replace(c.robot, gravity=np.zeros(3))
    got = smoothed_motion(still, robot, ImuStage(imus={"imu_a": known}))
    assert got.mounted["imu_a"].delay == pytest.approx(0.004, abs=5e-4)
    late = got.mounted["imu_a"].place.channels + 6
    assert np.sqrt(np.linalg.inv(got.mounted["imu_a"].precision)[late, late]) > 3e-4


@pytest.mark.parametrize("joints", [1, 2, 6])
def test_every_sensor_fault_at_once_leaves_fusion_better(joints: int) -> None:
    rig = Rig(joints, COARSE if joints < 6 else 0, fault=EVERYTHING)
    assert len(fused(rig).mounted) == len(recorded(rig).robot.imus)
    assert (error(rig) < (0.1 if joints < 6 else 0.6) * alone(rig)).all()
    assert (coverage(rig) < 1.5).all()


def test_a_calibration_of_the_channels_is_used() -> None:
    """With everything known, a second of data is enough; unknown gains of 10 % are not."""
    rig = Rig(1, COARSE)
    c = recorded(rig)
    gains, bias = 1.0 + 0.1 * np.linspace(-1, 1, 12), 0.5 * np.linspace(1, -1, 12)
    values = c.recording.accelerometers["imu_a"] * gains + bias
    array, own = c.plant.imus[0], c.stage.imus["imu_a"]
    known = ImuCalibration(
        rotation=own.rotation,
        std_error_deg=own.std_error_deg,
        lever=list(array.lever),
        lever_std_errors=[1e-3] * 3,
        accelerometer_scale=list(gains),
        accelerometer_scale_std_errors=[1e-3] * 12,
        accelerometer_bias=list(bias),
        accelerometer_bias_std_errors=[0.02] * 12,
        accelerometer_axes=array.axes.tolist(),
        accelerometer_tilt_std_errors_deg=[0.05] * 12,
    )
    recording = replace(c.recording, accelerometers={"imu_a": values})
    got = smoothed_motion(recording, c.robot, ImuStage(imus={"imu_a": known}))
    assert rms(got.ddq - c.truth)[0] < 1.1 * error(rig)[0]
    np.testing.assert_allclose(got.mounted["imu_a"].place.lever, array.lever, atol=2e-3)


@pytest.mark.parametrize("layout", ["end", "two", "each"])
def test_six_joints_with_arrays_and_standard_errors(layout: str) -> None:
    rig = Rig(6, layout=layout)
    assert (error(rig) < 0.75 * alone(rig)).all()
    assert (coverage(rig) < 1.5).all()
    assert (coverage(rig) > 0.5).all()


@pytest.mark.parametrize("joints", [1, 2, 6])
def test_ordinary_imus_with_gyros(joints: int) -> None:
    rig = Rig(joints, COARSE if joints < 6 else 0, gyro=True)
    assert (error(rig) < (0.1 if joints < 6 else 0.8) * alone(rig)).all()
    assert (coverage(rig) < 1.6).all()


@pytest.mark.parametrize("joints", [1, 2, 6])
def test_an_imu_lost_midway_costs_only_what_it_saw(joints: int) -> None:
    rig = Rig(joints, COARSE if joints < 6 else 0, fault=Fault(lost=True))
    got, c = fused(rig), recorded(rig)
    half = len(c.truth) // 2
    off = (got.ddq - c.truth)[: half - 100]
    before = np.sqrt(np.mean(off[200:] ** 2, axis=0))
    assert (before < (0.1 if joints < 6 else 0.75) * alone(rig)).all()
    assert (error(rig) < 1.1 * alone(rig)).all()
    assert (coverage(rig) < 1.6).all()


def test_clipped_readings_are_left_out() -> None:
    rig = Rig(2, COARSE, fault=Fault(limit=20.0))
    assert np.mean(np.abs(recorded(rig).recording.accelerometers["imu_b"]) >= 20.0) > 1e-3
    assert (error(rig) < 1.5 * error(Rig(2, COARSE))).all()


def test_one_dead_channel_does_not_cost_the_array() -> None:
    rig = Rig(2, COARSE)
    c = recorded(rig)
    values = c.recording.accelerometers["imu_b"].copy()
    values[1500:, 4] = values[1500, 4]
    recording = replace(c.recording, accelerometers=c.recording.accelerometers | {"imu_b": values})
    got = smoothed_motion(recording, c.robot, c.stage)
    assert tuple(got.mounted) == ("imu_a", "imu_b")
    assert (rms(got.ddq - c.truth) < 1.3 * error(rig)).all()


def test_positions_that_are_not_numbers_are_bridged() -> None:
    rig = Rig(2, COARSE)
    c = recorded(rig)
    q = c.recording.q.copy()
    q[1000:1200, 1], q[50, 0], q[-5:] = np.nan, np.inf, np.nan
    got = smoothed_motion(replace(c.recording, q=q), c.robot, c.stage)
    assert np.isfinite(got.ddq).all()
    assert (rms(got.ddq - c.truth) < 1.2 * error(rig)).all()
    assert np.abs(got.q - c.log.truth.q)[SETTLED].max() < 0.01


def bent(c: Case, joint: int, deg: float) -> Case:
    """The same with a joint axis that the robot file has wrong."""
    R = c.robot.chain.rotation.copy()
    R[joint] = R[joint] @ Rotation.from_euler("x", deg, degrees=True).as_matrix()
    return replace(c, robot=replace(c.robot, chain=replace(c.robot.chain, rotation=R)))


@pytest.mark.parametrize(("joint", "deg"), [(3, 5.0), (4, 30.0)])
def test_wrong_geometry_leaves_an_imu_out_and_says_so(joint: int, deg: float) -> None:
    rig = Rig(6)
    c = bent(recorded(rig), joint, deg)
    got = smoothed_motion(c.recording, c.robot, c.stage)
    assert tuple(got.mounted) == ("imu_a",)
    assert any("imu_b is left out" in note and "times its noise" in note for note in got.notes)
    assert (rms(got.ddq - c.truth) < 1.05 * alone(rig)).all()


@pytest.mark.parametrize(("joints", "counts", "layout"), [(2, 2**17, "two"), (6, 4096, "two")])
def test_a_healthy_imu_is_kept_however_fine_the_encoders(
    joints: int, counts: int, layout: str
) -> None:
    """Jolts that coarse knots cannot follow are no contradiction."""
    rig = Rig(joints, counts, layout)
    c = recorded(rig)
    got = smoothed_motion(c.recording, c.robot, c.stage)
    assert tuple(got.mounted) == ("imu_a", "imu_b")
    assert not got.notes
    assert (rms(got.ddq - c.truth) < 0.5 * alone(rig)).all()


def test_a_badly_fitting_imu_is_named() -> None:
    c = recorded(Rig(2, COARSE))
    position = c.robot.chain.position.copy()
    position[1] *= 1.2
    robot = replace(c.robot, chain=replace(c.robot.chain, position=position))
    got = smoothed_motion(c.recording, robot, c.stage)
    assert any("imu_b" in note and "times its noise" in note for note in got.notes)
    assert (rms(got.ddq - c.truth) < alone(Rig(2, COARSE))).all()
