"""Accelerations of links that no encoder tells: their sizes, and the joints that have them."""

from functools import lru_cache

import numpy as np
import pytest

from seqid_cli.discover.notes import deflection_notes
from seqid_cli.identify.imu_calibration.calibrate import deflecting, verdict_of
from seqid_cli.identify.imu_calibration.deflection import likeliest
from seqid_cli.identify.imu_calibration.normal_equations import Rows, Sizes
from seqid_cli.params.schema import EffectOfJoint, ImuStage, Stages
from tests import Array
from tests.plants.instruments import (
    BACKLASH,
    ELASTIC,
    STIFF,
    Case,
    calibrated,
    instruments,
    scene_of,
    scored,
)

pytestmark = pytest.mark.slow


def drawn(sizes: Array, noise: Array, *, nodes: int = 3000, channels: int = 6) -> Rows:
    """Rows of two kinds of sensors, whose accelerations and noise are white and of known size."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((nodes, 2, channels, len(sizes)))
    a = sizes * rng.standard_normal((nodes, len(sizes)))
    white = np.sqrt(noise)[:, None] * rng.standard_normal((nodes, 2, channels))
    r = np.einsum("ngcj,nj->ngc", A, a) + white
    return Rows(
        B=np.einsum("ngci,ngcj->ngij", A, A),
        u=np.einsum("ngck,ngc->ngk", A, r),
        share=np.ones(nodes),
        squares=np.sum(r**2, axis=2),
        count=np.full((nodes, 2), float(channels)),
    )


FIRST = Sizes(np.ones(2), np.ones(2))
NOISE = np.array([0.3, 4.0])


def test_sizes_are_those_that_were_drawn() -> None:
    found = likeliest(drawn(np.array([2.0, 0.0]), NOISE), FIRST)
    assert found.noise == pytest.approx(NOISE, rel=0.03)
    assert found.deflection[0] == pytest.approx(2.0, rel=0.04)
    assert found.deflection[1] < 0.1


@lru_cache(maxsize=3)
def stage(case: Case) -> ImuStage:
    return calibrated(scene_of(case), 0)


def test_a_stiff_arm_has_no_joint_that_deflects() -> None:
    found = stage(STIFF)
    assert all(deflecting(calibration) is None for calibration in found.imus.values())
    assert not any("elastic" in verdict.reason for verdict in found.verdicts)
    assert deflection_notes(Stages(imu=found), scene_of(STIFF).robot) == ()


@pytest.mark.parametrize("case", [ELASTIC, BACKLASH], ids=lambda case: case.label)
def test_the_joint_that_deflects_is_named_and_widens_errors(case: Case) -> None:
    """Joint 2: the IMU before it does not see it, the one behind it does."""
    before, behind = (stage(case).imus[name] for name in ("imu_a", "imu_b"))
    assert deflecting(before) is None
    named = deflecting(behind)
    assert named.joint == "joint_2"
    scene = scene_of(case)
    verdict = verdict_of(scene.robot, scene.robot.imus[1], behind, converged=True)
    assert "the link after joint_2" in verdict.reason
    z = scored(instruments(scene, 0)[1], behind).z_turn
    assert np.abs(z).max() < 3.0
    assert behind.std_error_deg > stage(STIFF).imus["imu_b"].std_error_deg


def test_a_diagnosis_hears_of_it_unless_the_file_has_the_effect() -> None:
    robot = scene_of(ELASTIC).robot
    (note,) = deflection_notes(Stages(imu=stage(ELASTIC)), robot)
    assert "joint_2" in note
    assert "joint_elasticity or backlash" in note
    has = EffectOfJoint(effect="backlash", joint="joint_2")
    assert deflection_notes(Stages(imu=stage(ELASTIC), effects=[has]), robot) == ()
