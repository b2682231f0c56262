"""Links that move though no encoder says so: joints that hunt, bend or play."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli import identify
from seqid_cli.discover.notes import deflection_notes
from seqid_cli.identify.imu_calibration import deflecting
from seqid_cli.params.schema import EffectOfJoint, ImuStage, Stages
from tests.plants import instruments as plants
from tests.plants.instruments import BACKLASH, ELASTIC, STIFF, Case, scene_of
from tests.studies.coverage.cases import case_of, draw, record

pytestmark = pytest.mark.slow

HUNTS = case_of("planar", 10039)  # joint 2 hunts in some swings of joint 1


def test_a_joint_that_hunts_leaves_lever_scales_and_errors(tmp_path: Path) -> None:
    """With joint 2 taken for locked the scales are 0.1 % off."""
    drawn = draw(HUNTS)
    record(
        HUNTS,
        replace(drawn, trials=[x for x in drawn.trials if x.stage == "imu"]),
        tmp_path,
    )
    file = identify.imu_calib(str(tmp_path / "imu"), tmp_path / "robot.toml")
    found = file.stages.imu.imus["imu_b"]
    lever, errors = np.array(found.lever[:2]), np.array(found.lever_std_errors[:2])
    (true,) = (imu.lever[:2] for imu in drawn.plant.imus if imu.name == "imu_b")
    assert np.all(np.abs(lever - true) < 3.0 * errors)
    assert np.abs(np.array(found.accelerometer_scale) - 1.0).max() < 5e-4
    by_lever = float(np.hypot(*(lever * errors)) / np.sum(lever**2))
    assert 0.4 * by_lever < found.acceleration_std_error < 1.2 * by_lever


@cache
def stage(case: Case) -> ImuStage:
    return plants.calibrated(scene_of(case), 0)


def test_a_stiff_arm_has_no_joint_that_deflects() -> None:
    found = stage(STIFF)
    assert set(map(deflecting, found.imus.values())) == {None}
    assert not any("elastic" in verdict.reason for verdict in found.verdicts)
    assert deflection_notes(Stages(imu=found), scene_of(STIFF).robot) == ()


@pytest.mark.parametrize("case", [ELASTIC, BACKLASH], ids=lambda case: case.label)
def test_the_joint_that_deflects_is_named_and_widens_errors(case: Case) -> None:
    """Joint 2: the IMU before it does not see it, the one behind it does."""
    scene, found = scene_of(case), stage(case)
    assert deflecting(found.imus["imu_a"]) is None
    behind = found.imus["imu_b"]
    assert deflecting(behind).joint == "joint_2"
    assert "the link after joint_2" in " ".join(
        verdict.reason for verdict in found.verdicts
    )
    assert (
        np.abs(plants.scored(plants.instruments(scene, 0)[1], behind).z_turn).max()
        < 3.0
    )
    assert behind.std_error_deg > stage(STIFF).imus["imu_b"].std_error_deg


def test_a_diagnosis_hears_of_it_unless_the_file_has_the_effect() -> None:
    robot = scene_of(ELASTIC).robot
    (note,) = deflection_notes(Stages(imu=stage(ELASTIC)), robot)
    assert "joint_2" in note
    assert "joint_elasticity or backlash" in note
    has = EffectOfJoint(effect="backlash", joint="joint_2")
    assert deflection_notes(Stages(imu=stage(ELASTIC), effects=[has]), robot) == ()
