"""The smoother on simulated rigs and their faults, against the truth and its model's
bound.
"""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.imu.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Chain
from tests.plants.fused import Fault, Rig
from tests.unit.imu.smoother import rigs
from tests.unit.imu.smoother.rigs import (
    RIGS,
    alone,
    coverage,
    error,
    recorded,
    rms,
    smoothed,
    variance,
)

pytestmark = pytest.mark.slow
COARSE = 600  # counts per turn
TWO = Rig(2, COARSE)
EVERYTHING = Fault(bias=0.2, drift=0.05, gain=0.01, tilt_deg=0.5, delay_s=0.0203)


def again(rig: Rig, *, chain: Chain | None = None, **changed: object) -> Smoothed:
    c = recorded(rig)
    robot = replace(c.robot, chain=chain or c.robot.chain)
    return smoothed_motion(replace(c.recording, **changed), robot, c.stage)


@pytest.mark.parametrize("name", RIGS)
def test_both_sources_together_come_near_the_bound_with_the_error_stated(
    name: str,
) -> None:
    """The bound takes jerks for equally large all the time: the smoother may come below
    it.
    """
    rig = RIGS[name]
    s = rigs.scene(name)
    share = {"six": 0.75, "two": 0.06}.get(name, 0.05)
    assert (error(rig) < share * rigs.differentiated(s)).all()
    assert (error(rig) < 0.75 * rigs.from_imus(s)).all()
    assert (error(rig) < 1.3 * rigs.bound(s, rig)).all()
    got = smoothed(rig)
    truth = s.log.truth
    off = np.stack([got.q - truth.q, got.dq - truth.dq, got.ddq - truth.ddq], axis=2)
    ratio = rms(off / np.sqrt(variance(got)))
    assert 0.5 < ratio.min() < ratio.max() < 1.8
    assert tuple(got.mounted) == tuple(imu.name for imu in s.plant.imus)
    # turns about z do not show how far along z it is
    determined = slice(0, 3 if name == "six" else 2)
    for imu in s.plant.imus:
        lever = got.mounted[imu.name].place.lever
        np.testing.assert_allclose(lever[determined], imu.lever[determined], atol=2e-3)


@pytest.mark.parametrize("name", RIGS)
def test_without_imus_it_is_as_good_as_the_best_differentiation(name: str) -> None:
    got = smoothed(RIGS[name], imus=False)
    assert tuple(got.mounted) == ()
    assert (alone(RIGS[name]) < 1.1 * rigs.differentiated(rigs.scene(name))).all()
    assert (coverage(RIGS[name], got) < 2.5).all()


@pytest.mark.parametrize(
    ("rig", "share", "least", "most"),
    [
        *((Rig(n, COARSE, fault=EVERYTHING), 0.1, 0.0, 1.5) for n in (1, 2)),
        (Rig(6, fault=EVERYTHING), 0.6, 0.0, 1.5),
        *((Rig(6, layout=layout), 0.75, 0.5, 1.5) for layout in ("end", "two", "each")),
        *((Rig(n, COARSE, gyro=True), 0.1, 0.0, 1.6) for n in (1, 2)),
        (Rig(6, gyro=True), 0.8, 0.0, 1.6),
    ],
)
def test_any_sensors_and_their_faults_leave_fusion_better(
    rig: Rig, share: float, least: float, most: float
) -> None:
    assert len(smoothed(rig).mounted) == len(recorded(rig).robot.imus)
    assert (error(rig) < share * alone(rig)).all()
    assert least <= coverage(rig).min()
    assert coverage(rig).max() < most


@pytest.mark.parametrize("joints", [1, 2, 6])
def test_an_imu_lost_midway_costs_only_what_it_saw(joints: int) -> None:
    rig = Rig(joints, COARSE if joints < 6 else 0, fault=Fault(lost=True))
    truth = recorded(rig).truth
    off = (smoothed(rig).ddq - truth)[200 : len(truth) // 2 - 100]
    error_before = np.sqrt(np.mean(off**2, axis=0))
    assert (error_before < (0.1 if joints < 6 else 0.75) * alone(rig)).all()
    assert (error(rig) < 1.1 * alone(rig)).all()
    assert (coverage(rig) < 1.6).all()


@pytest.mark.parametrize("late", [0.002, 0.02, -0.0137])
@pytest.mark.parametrize("joints", [1, 2])
def test_a_late_clock_is_found(joints: int, late: float) -> None:
    right = Rig(joints, COARSE)
    off = replace(right, fault=Fault(delay_s=late))
    for name, mounted in smoothed(off).mounted.items():
        assert abs(mounted.delay - late) < 1e-4, name
    # Between samples, where accelerations jump, readings tell less.
    assert (error(off) < 2.0 * error(right)).all()
    assert (error(off) < 0.1 * alone(right)).all()


def test_a_clock_that_drifts_is_found() -> None:
    """Stamps 40 ms late gain 15 ms within the log: no offset alone explains them."""
    right = Rig(2, COARSE)
    off = replace(right, fault=Fault(delay_s=0.04, rate=3.3e-3))
    c = recorded(off)
    imus = {
        name: msgspec.structs.replace(
            calibration,
            time_offset_s=0.0,
            time_offset_std_error_s=0.02,
            time_rate=3e-3,
            time_rate_std_error=3e-4,
        )
        for name, calibration in c.stage.imus.items()
    }
    got = smoothed_motion(c.recording, c.robot, ImuStage(imus=imus))
    for name, mounted in got.mounted.items():
        begins_late = mounted.delay - mounted.rate * mounted.middle_s
        assert abs(mounted.rate - 3.3e-3) < 1e-4, name
        assert abs(begins_late - 0.04) < 3e-4, name
    # Between samples, where accelerations jump, readings tell less.
    assert (error(off, got) < 2.0 * error(right)).all()
    assert (error(off, got) < 0.1 * alone(right)).all()


def test_a_calibration_of_the_channels_is_used() -> None:
    """A second of data is enough with everything known; unknown gains need more."""
    rig = Rig(1, COARSE)
    c = recorded(rig)
    gains = 1.0 + 0.1 * np.linspace(-1, 1, 12)
    bias = 0.5 * np.linspace(1, -1, 12)
    values = c.recording.accelerometers["imu_a"] * gains + bias
    array = c.plant.imus[0]
    calibration = c.stage.imus["imu_a"]

    errors = {
        "scale_std_errors": 1e-3,
        "bias_std_errors": 0.02,
        "tilt_std_errors_deg": 0.05,
    }
    calibrated = msgspec.structs.replace(
        calibration,
        lever=list(array.lever),
        lever_std_errors=[1e-3] * 3,
        accelerometer_scale=list(gains),
        accelerometer_bias=list(bias),
        accelerometer_axes=array.axes.tolist(),
        noise_density=None,
        **{f"accelerometer_{name}": [size] * 12 for name, size in errors.items()},
    )

    recording = replace(c.recording, accelerometers={"imu_a": values})
    got = smoothed_motion(recording, c.robot, ImuStage(imus={"imu_a": calibrated}))
    assert error(rig, got)[0] < 1.1 * error(rig)[0]
    np.testing.assert_allclose(got.mounted["imu_a"].place.lever, array.lever, atol=2e-3)


def test_damaged_readings_and_positions_cost_little() -> None:
    # An accelerometer at its limit.
    clipped = replace(TWO, fault=Fault(limit=20.0))
    readings = recorded(clipped).recording.accelerometers["imu_b"]
    assert np.mean(np.abs(readings) >= 20.0) > 1e-3
    assert (error(clipped) < 1.5 * error(TWO)).all()
    log = recorded(TWO).recording
    truth = recorded(TWO).log.truth

    # A channel that sticks.
    values = log.accelerometers["imu_b"].copy()
    values[1500:, 4] = values[1500, 4]
    got = again(TWO, accelerometers=log.accelerometers | {"imu_b": values})
    assert tuple(got.mounted) == ("imu_a", "imu_b")
    assert (error(TWO, got) < 1.3 * error(TWO)).all()

    # Positions that are no numbers.
    q = log.q.copy()
    q[1000:1200, 1] = np.nan
    q[50, 0] = np.inf
    q[-5:] = np.nan
    got = again(TWO, q=q)
    assert np.isfinite(got.ddq).all()
    assert (error(TWO, got) < 1.2 * error(TWO)).all()
    assert np.abs(got.q - truth.q)[rigs.SETTLED].max() < 0.01

    # Positions that are wrong and said to be.
    s = recorded(RIGS["one"])
    valid = s.recording.valid.copy()
    q = s.recording.q.copy()
    valid[1000:1100] = False
    q[1000:1100] = 7.0
    got = again(RIGS["one"], valid=valid, q=q)
    off = (got.ddq - s.truth)[:, 0]
    for part in (slice(200, 950), slice(1150, -200)):
        assert np.sqrt(np.mean(off[part] ** 2)) < 0.3
    assert np.isfinite(np.sqrt(variance(got))).all()


@pytest.mark.parametrize(("joint", "deg"), [(3, 5.0), (4, 30.0)])
def test_wrong_geometry_leaves_an_imu_out_and_says_so(joint: int, deg: float) -> None:
    rig = Rig(6)
    chain = recorded(rig).robot.chain
    R = chain.rotation.copy()
    R[joint] = R[joint] @ Rotation.from_euler("x", deg, degrees=True).as_matrix()
    got = again(rig, chain=replace(chain, rotation=R))
    assert tuple(got.mounted) == ("imu_a",)
    assert any(
        "imu_b is left out" in note and "times its noise" in note for note in got.notes
    )
    assert (error(rig, got) < 1.05 * alone(rig)).all()


def test_a_badly_fitting_imu_is_named() -> None:
    chain = recorded(TWO).robot.chain
    got = again(
        TWO, chain=replace(chain, position=chain.position * np.array([[1.0], [1.2]]))
    )
    assert any("imu_b" in note and "times its noise" in note for note in got.notes)
    assert (error(TWO, got) < alone(TWO)).all()


@pytest.mark.parametrize("rig", [Rig(2, 2**17), Rig(6, 4096)])
def test_a_healthy_imu_is_kept_however_fine_the_encoders(rig: Rig) -> None:
    """Jolts that coarse knots cannot follow are no contradiction."""
    got = smoothed(rig)
    assert tuple(got.mounted) == ("imu_a", "imu_b")
    assert not got.notes
    assert (error(rig) < 0.5 * alone(rig)).all()


def test_chunks_join_without_a_seam() -> None:
    s = rigs.scene("one")
    in_one_chunk = smoothed(RIGS["one"])
    got = smoothed_motion(s.recording, s.robot, s.stage, chunk_s=1.2)
    assert (
        rms((got.ddq - in_one_chunk.ddq) / np.sqrt(variance(in_one_chunk)[:, :, 2]))[0]
        < 0.5
    )
    assert np.abs(np.diff(got.q - in_one_chunk.q, axis=0)).max() < 1e-4
    assert error(RIGS["one"], got)[0] < 1.1 * error(RIGS["one"])[0]


def test_a_slower_log_is_smoothed_on_finer_knots() -> None:
    """Accelerations jump between samples; what a quarter of the readings tell is not
    lost.
    """
    rig = RIGS["two"]
    log = recorded(rig).recording
    fewer = {name: getattr(log, name)[::4] for name in ("t", "q", "valid")}
    readings = {name: x[::4] for name, x in log.accelerometers.items()}
    health = replace(log.health, rate_hz=250.0)
    got = again(rig, health=health, accelerometers=readings, **fewer)
    inner = slice(50, -50)
    off = (got.ddq - recorded(rig).truth[::4])[inner]
    assert (np.sqrt(np.mean(off**2, axis=0)) < 1.6 * error(rig)).all()
    ratio = np.sqrt(np.mean(off**2 / variance(got)[inner, :, 2], axis=0))
    assert 0.5 < ratio.min() < ratio.max() < 1.8
