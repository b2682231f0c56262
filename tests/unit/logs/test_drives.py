"""Channels that are not the model's own: degrees, torque without gravity, voltage, sensors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Channels, Robot
from tests import ROOT

SIX = ROOT / "sample_logs" / "six_joint"
LOG = SIX / "validation" / "fourier_1.parquet"
ROBOT = load_robot(SIX / "robot.toml")
NAMES = ROBOT.joint_names


def columns() -> dict[str, np.ndarray]:
    table = pq.read_table(LOG)
    return {n: table.column(n).to_numpy() for n in table.column_names if not n.startswith("imu")}


def written(folder: Path, logged: dict[str, np.ndarray]) -> Path:
    pq.write_table(pa.table(logged), folder / "log.parquet")
    return folder / "log.parquet"


def with_channels(channels: Channels, **joint: float) -> Robot:
    joints = tuple(replace(one, **joint) for one in ROBOT.joints)
    return replace(ROBOT, joints=joints, channels=channels, imus=())


def test_degrees_of_all_angles(tmp_path: Path) -> None:
    logged, truth = columns(), read_recording(LOG, ROBOT)
    for name in NAMES:
        logged[f"{name}.position"] = np.rad2deg(logged[f"{name}.position"])
        logged[f"{name}.link_position"] = logged[f"{name}.position"] + 1.0
    read = read_recording(written(tmp_path, logged), with_channels(Channels(unit="deg")))
    np.testing.assert_allclose(read.q, truth.q, atol=1e-12)
    np.testing.assert_allclose(read.link_position - read.q, np.pi / 180.0, atol=1e-12)


def test_the_gravity_that_a_driver_subtracts_is_added_again(tmp_path: Path) -> None:
    """By the potential energy of the URDF's bodies: its slope is the gravity torque."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(SIX / "six_joint.urdf"))
    data, truth = model.createData(), read_recording(LOG, ROBOT)
    rows = slice(None, None, 500)
    gravity = np.array([pin.computeGeneralizedGravity(model, data, q) for q in truth.q])
    logged = {n: v for n, v in columns().items() if not n.endswith(".current")}
    for j, name in enumerate(NAMES):
        logged[f"{name}.effort"] = truth.tau[:, j] - gravity[:, j]
    robot = with_channels(Channels(effort="gravity_compensated"))
    read = read_recording(written(tmp_path, logged), robot)
    np.testing.assert_allclose(read.tau[rows], truth.tau[rows], atol=1e-9)
    assert np.abs(gravity).max() > 10.0


def test_gravity_compensation_without_a_model_is_refused(tmp_path: Path) -> None:
    text = (ROOT / "sample_logs" / "one_joint" / "robot.toml").read_text()
    path = tmp_path / "robot.toml"
    path.write_text(text.replace('effort = "current"', 'effort = "gravity_compensated"'))
    with pytest.raises(ConfigError, match="the gravity that the driver subtracts") as caught:
        load_robot(path)
    assert "urdf with <inertial>" in caught.value.hint


@pytest.mark.parametrize("logged_as", ["voltage", "pwm"])
@pytest.mark.parametrize("velocity", [True, False])
def test_voltage_and_duty_cycle_give_the_current(
    tmp_path: Path, logged_as: str, velocity: bool
) -> None:
    """u = R i + k_e w, at the motor."""
    logged, truth = columns(), read_recording(LOG, ROBOT)
    t, resistance, supply = logged["t"], 2.5, 24.0
    for joint in ROBOT.joints:
        dq = np.gradient(logged[f"{joint.name}.position"], t)
        back = joint.torque_constant * joint.gear_ratio * dq
        voltage = resistance * logged.pop(f"{joint.name}.current") + back
        logged[f"{joint.name}.{logged_as}"] = voltage / (supply if logged_as == "pwm" else 1.0)
        if velocity:
            logged[f"{joint.name}.velocity"] = dq
    robot = with_channels(Channels(), winding_resistance=resistance, supply_voltage=supply)
    read = read_recording(written(tmp_path, logged), robot)
    assert read.tau is not None
    assert truth.tau is not None
    np.testing.assert_allclose(read.tau, truth.tau, atol=1e-6)


def test_a_torque_sensor_stands_beside_the_motors_torque(tmp_path: Path) -> None:
    logged = columns()
    for j, name in enumerate(NAMES):
        logged[f"{name}.load"] = np.full(len(logged["t"]), float(j))
    read = read_recording(written(tmp_path, logged), replace(ROBOT, imus=()))
    assert read.load is not None
    np.testing.assert_array_equal(read.load, np.tile(np.arange(6.0), (len(read.t), 1)))
    truth = read_recording(LOG, ROBOT)
    np.testing.assert_array_equal(read.tau, truth.tau)
    del logged["elbow.load"]
    some = read_recording(written(tmp_path, logged), replace(ROBOT, imus=()))
    assert some.load is None
    assert "load is logged for some joints only; it is left out" in some.health.warnings


def test_effects_take_the_measured_load(tmp_path: Path) -> None:
    from seqid_cli.model.effects.apply import scene_of_log
    from seqid_cli.model.torque import TorqueModel
    from seqid_cli.motion.motion import estimate_motion
    from seqid_cli.motion.options import MotionOptions
    from seqid_cli.params.schema import Stages

    logged = columns()
    for name in NAMES:
        logged[f"{name}.load"] = np.sin(logged["t"])
    robot = replace(ROBOT, imus=())
    read = read_recording(written(tmp_path, logged), robot)
    motion = estimate_motion(read, robot, MotionOptions(cutoff_hz=10.0))
    scene = scene_of_log(read, robot, TorqueModel.from_stages(Stages(), robot), motion)
    middle = slice(100, -100)
    slow = np.tile(np.sin(read.t)[:, None], (1, 6))
    np.testing.assert_allclose(scene.load[middle], slow[middle], atol=1e-3)
    bare = scene_of_log(replace(read, load=None), robot, scene.model, motion)
    assert np.abs(bare.load - slow).max() > 1.0  # of the model, which has rotors alone
