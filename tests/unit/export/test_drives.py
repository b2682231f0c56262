"""A drive as MuJoCo takes it: run from the commands, it moves as the log has it."""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec import structs

from seqid_cli import drive as drives
from seqid_cli.drive.settings import DriveSettings, WindowSettings
from seqid_cli.errors import ConfigError
from seqid_cli.export import export
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id
from seqid_cli.params.encode import encode
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.robot.file import load_robot
from tests.plants.driven import DH, GEAR, DrivenArm, multisine, simulate_drive
from tests.unit.drive.test_drive import arm, file_of


@cache
def driven() -> DrivenArm:
    return arm().with_drive(velocity_feedforward=np.zeros(1))


@cache
def log() -> Recording:
    return simulate_drive(driven(), multisine(4, 1, 8.0), 8.0, seed=4)


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    alpha, a, d, theta0 = DH[0]
    path = tmp_path / "robot.toml"
    path.write_text(
        'schema = "seqid/robot@1"\nname = "driven"\ngravity = [0.0, 0.0, -9.81]\n'
        f'[[joint]]\nname = "joint_1"\ngear_ratio = {GEAR}\n'
        f"dh = {{ alpha = {alpha}, a = {a}, d = {d}, theta0 = {theta0} }}\n"
    )
    return path


def drive_file(folder: Path, robot_file: Path) -> tuple[Path, DriveFile]:
    robot = load_robot(robot_file)
    file = drives.drive(
        [log()],
        robot,
        structs.replace(file_of(driven()), robot=robot_id(robot)),
        settings=DriveSettings(windows=WindowSettings(most=0.0)),
    )
    path = folder / "drive.json"
    path.write_text(encode(file))
    return path, file


def test_mujoco_follows_the_log_from_its_commands(
    tmp_path: Path, robot_file: Path
) -> None:
    path, file = drive_file(tmp_path, robot_file)
    target = tmp_path / "arm.xml"
    written = export(path, robot_file, target)
    assert any("ms late" in note for note in written.notes)

    model = mujoco.MjModel.from_xml_string(target.read_text())
    model.opt.timestep = 1e-3
    data = mujoco.MjData(model)
    t = np.arange(0.0, 8.0, 1e-3)
    delay = file.joints["joint_1"].value("command_delay")
    command = np.interp(t - delay, log().t, log().command[:, 0])
    data.qpos[:] = log().q[0]
    position = np.empty_like(t)
    for k, asked in enumerate(command):
        position[k] = data.qpos[0]
        data.ctrl[:] = asked
        mujoco.mj_step(model, data)
    off = np.interp(log().t, t, position) - log().q[:, 0]
    travel = float(np.ptp(log().q))
    assert np.sqrt(np.mean(off**2)) < 0.01 * travel


def test_a_drive_has_no_place_in_other_forms(tmp_path: Path, robot_file: Path) -> None:
    path, _ = drive_file(tmp_path, robot_file)
    with pytest.raises(ConfigError, match="a drive is not written as"):
        export(path, robot_file, tmp_path / "arm.h")
