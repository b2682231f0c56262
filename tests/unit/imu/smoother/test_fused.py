"""Fused motion on simulated rigs: its error, its cut-off, and when encoders are kept
instead.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.imu.link_acceleration import best_motion
from seqid_cli.imu.smoother.fused import fused_motion
from seqid_cli.imu.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.typing import Array
from tests.plants.fused import Case
from tests.unit.imu.smoother.rigs import scene as simulated

pytestmark = pytest.mark.slow


@cache
def scene(name: str) -> Case:
    """A rig of the smoother's own tests, with torque that is its acceleration."""
    of_rig = simulated(name)
    return replace(
        of_rig, recording=replace(of_rig.recording, tau=of_rig.log.truth.ddq.copy())
    )


def encoder(s: Case, hz: float | None = None) -> Motion:
    return estimate_motion(s.recording, s.robot, MotionOptions(hz))


@cache
def fused(name: str, hz: float | None = None) -> Motion:
    s = scene(name)
    return fused_motion(s.recording, s.robot, s.stage, encoder(s, hz))


def error(s: Case, motion: Motion) -> Array:
    true = motion.lowpass(s.log.truth.ddq)
    return np.asarray(np.sqrt(np.mean((motion.ddq - true)[motion.usable] ** 2, axis=0)))


@pytest.mark.parametrize("name", ["one", "one_400", "two"])
def test_more_band_and_far_less_error_than_encoders_and_as_said(name: str) -> None:
    s = scene(name)
    motion = fused(name)
    by_encoders = encoder(s)
    assert motion.cutoff.hz > 1.1 * by_encoders.cutoff.hz
    assert (error(s, motion) < 0.15 * error(s, by_encoders)).all()
    assert (motion.acceleration_error < 0.15 * motion.encoder_error).all()
    for hz in (5.0, 10.0, 40.0):
        below = fused(name, hz)
        ratio = error(s, below) / below.error
        assert 0.5 < ratio.min() <= ratio.max() < 1.5


@pytest.mark.parametrize("name", ["one", "two"])
def test_an_inertia_is_not_shrunk_by_the_smoothers_error(name: str) -> None:
    motion = fused(name, 40.0)
    assert motion.lowpass.cutoff_hz == motion.cutoff.hz == 40.0
    x = motion.filtered(motion.ddq)[motion.usable]
    y = motion.tau[motion.usable]
    slope = np.sum(x * y, axis=0) / np.sum(x * x, axis=0)
    np.testing.assert_allclose(slope, 1.0, atol=5e-4)


def changed(s: Case, **given: object) -> Case:
    return replace(s, recording=replace(s.recording, **given))


def without(s: Case, *names: str) -> Case:
    others_readings = {
        k: v for k, v in s.recording.accelerometers.items() if k not in names
    }
    return changed(s, accelerometers=others_readings)


def best(s: Case, source: str) -> Motion:
    return best_motion(s.recording, s.robot, s.stage, encoder(s), source=source)


@pytest.mark.parametrize("lacks", ["recorded", "calibrated"])
def test_one_imu_missing_is_said_and_the_other_used(lacks: str) -> None:
    s = scene("two")
    only = replace(s, stage=ImuStage(imus={"imu_b": s.stage.imus["imu_b"]}))
    got = best(without(s, "imu_a") if lacks == "recorded" else only, "auto")
    assert (got.source, got.imus) == ("fused", ("imu_b",))
    assert got.warnings == (f"imu_a is not {lacks}",)


@pytest.mark.parametrize("lacks", ["readings", "calibrations", "stage", "imus"])
def test_without_any_imu_the_encoders_stay_and_nobody_can_insist(lacks: str) -> None:
    s = scene("two")
    s = {
        "readings": without(s, "imu_a", "imu_b"),
        "calibrations": replace(s, stage=ImuStage(imus={})),
        "stage": replace(s, stage=None),
        "imus": replace(s, robot=replace(s.robot, imus=())),
    }[lacks]
    got = best(s, "auto")
    assert got.source == "encoder"
    np.testing.assert_array_equal(got.ddq, encoder(s).ddq)
    assert bool(got.warnings) == (lacks in ("readings", "calibrations"))
    why = "the robot file names no IMU" if lacks == "imus" else "in this log: imu_a"
    for source in ("fused", "imu"):
        with pytest.raises(InputError, match=why) as caught:
            best(s, source)
        assert "seqid imu-calib" in caught.value.hint


def test_a_link_that_does_not_follow_its_encoder_is_not_smoothed_over() -> None:
    """The default falls back, and says which encoder; insisting goes on, and says so
    too.
    """
    s = scene("two")
    wavy = s.recording.q + 0.1 * np.sin(4 * s.recording.q) * np.array([0.0, 1.0])
    off = changed(s, q=wavy)
    got = best(off, "auto")
    assert got.source == "encoder"
    assert any(
        "the encoder of" in x and "encoders alone are used" in x for x in got.warnings
    )
    np.testing.assert_array_equal(got.ddq, encoder(off).ddq)
    forced = best(off, "fused")
    assert forced.source == "fused"
    assert any(warning.endswith("disagree") for warning in forced.warnings)


@pytest.mark.parametrize(
    ("name", "source"), [("one", "fused"), ("two", "fused"), ("six", "encoder")]
)
def test_effects_are_looked_for_by_imus_beside_coarse_encoders(
    name: str, source: str
) -> None:
    assert best(scene(name), "needed").source == source


def test_a_motion_is_smoothed_once_whatever_the_torque(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Other torque changes nothing; other positions, readings or calibrations do."""
    s = scene("one")
    counted = []

    def smooth(*arguments: Any) -> Smoothed:
        counted.append(arguments)
        return smoothed_motion(*arguments)

    monkeypatch.setattr("seqid_cli.imu.smoother.smooth.smoothed_motion", smooth)
    noisy = s.recording.q.copy()
    noisy[100] += 0.01
    first = changed(s, q=noisy)
    readings = {"imu_a": s.recording.accelerometers["imu_a"] + 1e-9}
    turned = {
        k: msgspec.structs.replace(c, std_error_deg=0.2)
        for k, c in s.stage.imus.items()
    }
    plain = best(first, "fused")
    repeated = best(changed(first, tau=0 * noisy), "fused")
    np.testing.assert_array_equal(repeated.ddq, plain.ddq)
    assert len(counted) == 1
    best(changed(first, accelerometers=readings), "fused")
    best(replace(first, stage=ImuStage(imus=turned)), "fused")
    assert len(counted) == 3


def test_noise_of_locked_joints_is_no_motion() -> None:
    """Else it would pass for excitation of parameters that the log says nothing of."""
    s = scene("two")
    still = s.recording.q.copy()
    still[:, 1] = still[0, 1]
    got = best(without(changed(s, q=still), "imu_b"), "auto")
    assert got.source == "fused"
    assert not np.any([got.dq[:, 1], got.ddq[:, 1]])
    np.testing.assert_allclose(got.q[:, 1], still[:, 1], atol=1e-9)
    assert got.ddq[:, 0].any()


def test_joints_beyond_all_imus_keep_their_encoders() -> None:
    s = scene("two")
    got = best(without(s, "imu_b"), "fused")
    by_encoders = encoder(s, got.cutoff.hz)
    assert got.imus == ("imu_a",)
    for fused_values, encoder_values in (
        (got.q, by_encoders.q),
        (got.dq, by_encoders.dq),
        (got.ddq, by_encoders.ddq),
    ):
        np.testing.assert_allclose(fused_values[:, 1], encoder_values[:, 1], atol=1e-9)
    assert got.error[1] == pytest.approx(by_encoders.acceleration_error[1])
    assert got.error[0] < 0.2 * by_encoders.acceleration_error[0]
