"""Channels that are not the model's own: degrees, torque without gravity, voltage,
sensors.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from seqid_cli.effects.apply import scene_of_log
from seqid_cli.errors import ConfigError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Channels, Robot
from tests import ROOT
from tests.unit.inspect.faults import read_columns, write_columns
from tests.unit.inspect.planting import Columns

SIX = ROOT / "sample_logs" / "six_joint"
LOG = SIX / "validation" / "fourier_1.parquet"
ROBOT = load_robot(SIX / "robot.toml")
NAMES = ROBOT.joint_names
TRUTH = read_recording(LOG, ROBOT)


@pytest.fixture
def logged() -> Columns:
    return {
        name: x for name, x in read_columns(LOG).items() if not name.startswith("imu")
    }


def read(folder: Path, logged: Columns, robot: Robot) -> Recording:
    write_columns(folder / "log.parquet", logged)
    return read_recording(folder / "log.parquet", robot)


def with_channels(channels: Channels, **joint: float) -> Robot:
    joints = tuple(replace(one, **joint) for one in ROBOT.joints)
    return replace(ROBOT, joints=joints, channels=channels, imus=())


def test_degrees_of_all_angles(tmp_path: Path, logged: Columns) -> None:
    for name in NAMES:
        logged[f"{name}.position"] = np.rad2deg(logged[f"{name}.position"])
        logged[f"{name}.link_position"] = logged[f"{name}.position"] + 1.0
    found = read(tmp_path, logged, with_channels(Channels(unit="deg")))
    np.testing.assert_allclose(found.q, TRUTH.q, atol=1e-12)
    np.testing.assert_allclose(found.link_position - found.q, np.pi / 180.0, atol=1e-12)


def test_percent_of_the_limits(tmp_path: Path, logged: Columns) -> None:
    """-100 and 100 are the ends, which need not lie around zero."""
    low, high = -1.5, 2.5
    for name in NAMES:
        q = logged[f"{name}.position"]
        logged[f"{name}.position"] = 200.0 * (q - low) / (high - low) - 100.0
        logged[f"{name}.velocity"] = np.full_like(q, 50.0)
    joints = tuple(replace(one, position_limits=(low, high)) for one in ROBOT.joints)
    robot = replace(ROBOT, joints=joints, channels=Channels(unit="percent"), imus=())
    found = read(tmp_path, logged, robot)
    np.testing.assert_allclose(found.q, TRUTH.q, atol=1e-12)
    np.testing.assert_allclose(found.dq, 1.0)


UNITS = {
    "turn": (2.0 * np.pi, {}),
    "count": (0.0015, {"encoder_resolution": 0.0015}),
}


@pytest.mark.parametrize("unit", UNITS)
def test_other_units_of_all_angles(tmp_path: Path, logged: Columns, unit: str) -> None:
    size, joint = UNITS[unit]
    for name in NAMES:
        logged[f"{name}.velocity"] = np.gradient(logged[f"{name}.position"]) / size
        logged[f"{name}.position"] = logged[f"{name}.position"] / size
    robot = with_channels(Channels(unit=unit), **joint)
    found = read(tmp_path, logged, robot)
    np.testing.assert_allclose(found.q, TRUTH.q, atol=1e-9)
    np.testing.assert_allclose(found.dq, np.gradient(TRUTH.q, axis=0), atol=1e-9)


def test_a_unit_needs_what_it_rests_on(tmp_path: Path) -> None:
    text = (SIX / "robot.toml").read_text().replace("position_limits", "# ")
    text = text.replace("[channels]", '[channels]\nunit = "percent"')
    (tmp_path / "robot.toml").write_text(text)
    (tmp_path / "six_joint.urdf").write_text((SIX / "six_joint.urdf").read_text())
    with pytest.raises(ConfigError, match="position_limits"):
        load_robot(tmp_path / "robot.toml")


def test_gravity_that_a_driver_subtracts_is_added_again(
    tmp_path: Path, logged: Columns
) -> None:
    """By the potential energy of the URDF's bodies: its slope is the gravity torque."""
    model = pin.buildModelFromUrdf(str(SIX / "six_joint.urdf"))
    data = model.createData()
    gravity = np.array([pin.computeGeneralizedGravity(model, data, q) for q in TRUTH.q])
    for j, name in enumerate(NAMES):
        del logged[f"{name}.current"]
        logged[f"{name}.effort"] = TRUTH.tau[:, j] - gravity[:, j]
    found = read(
        tmp_path, logged, with_channels(Channels(effort="gravity_compensated"))
    )
    np.testing.assert_allclose(found.tau, TRUTH.tau, atol=1e-9)
    assert np.abs(gravity).max() > 10.0


@pytest.mark.parametrize("logged_as", ["voltage", "pwm"])
@pytest.mark.parametrize("velocity", [True, False])
def test_voltage_and_duty_cycle_give_the_current(
    tmp_path: Path, logged: Columns, logged_as: str, velocity: bool
) -> None:
    """u = R i + k_e w, at the motor."""
    resistance, supply = 2.5, 24.0
    for joint in ROBOT.joints:
        dq = np.gradient(logged[f"{joint.name}.position"], logged["t"])
        back = joint.torque_constant * joint.gear_ratio * dq
        voltage = resistance * logged.pop(f"{joint.name}.current") + back
        logged[f"{joint.name}.{logged_as}"] = voltage / (
            supply if logged_as == "pwm" else 1.0
        )
        if velocity:
            logged[f"{joint.name}.velocity"] = dq
    robot = with_channels(
        Channels(), winding_resistance=resistance, supply_voltage=supply
    )
    np.testing.assert_allclose(read(tmp_path, logged, robot).tau, TRUTH.tau, atol=1e-6)


def test_a_torque_sensor_is_the_load_of_effects(
    tmp_path: Path, logged: Columns
) -> None:
    slow = np.outer(np.sin(logged["t"]), np.linspace(0.0, 1.0, 6))
    logged |= {f"{name}.load": slow[:, j] for j, name in enumerate(NAMES)}
    robot = replace(ROBOT, imus=())
    found = read(tmp_path, logged, robot)
    np.testing.assert_array_equal(found.load, slow)
    np.testing.assert_array_equal(found.tau, TRUTH.tau)
    motion = estimate_motion(found, robot, MotionOptions(cutoff_hz=10.0))
    scene = scene_of_log(found, robot, TorqueModel.from_stages(Stages(), robot), motion)
    np.testing.assert_allclose(scene.load[100:-100], slow[100:-100], atol=1e-3)
    bare = scene_of_log(replace(found, load=None), robot, scene.model, motion)
    assert np.abs(bare.load - slow).max() > 1.0  # of the model, which has rotors alone
