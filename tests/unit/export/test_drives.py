"""A drive in each form, read back and run: it moves as the log has it."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
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

VISCOUS = "physxJointAxis:angular:viscousFrictionCoefficient"


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


@cache
def fitted_drive() -> DriveFile:
    return drives.drive(
        [log()],
        driven().robot,
        file_of(driven()),
        settings=DriveSettings(windows=WindowSettings(most=0.0)),
    )


@cache
def replay_error() -> float:
    replayed = drives.replay([log()], driven().robot, fitted_drive())
    return replayed.joints["joint_1"].position.rms


def drive_file(folder: Path, robot_file: Path) -> tuple[Path, DriveFile]:
    file = structs.replace(fitted_drive(), robot=robot_id(load_robot(robot_file)))
    path = folder / "drive.json"
    path.write_text(encode(file))
    return path, file


@dataclass(frozen=True)
class ReadBack:
    """What a form says of a joint, in N m, rad and s."""

    stiffness: float
    damping: float
    delay: float = 0.0
    armature: float | None = None  # None where the form has no place for it
    coulomb: float | None = None
    viscous: float | None = None


def read_ros2_control(text: str) -> ReadBack:
    parameters = yaml.safe_load(text)["joint_trajectory_controller"]["ros__parameters"]
    assert parameters["joints"] == ["joint_1"]
    gains = parameters["gains"]["joint_1"]
    # The damping is of the error of the speed: what is fed forward takes it off again.
    assert gains["ff_velocity_scale"] == pytest.approx(-gains["d"])
    assert gains["i"] == 0.0
    return ReadBack(gains["p"], gains["d"])


def read_isaac_lab(text: str) -> ReadBack:
    names: dict[str, Any] = {}
    exec(compile(text, "actuators.py", "exec"), names)
    physics_dt = 1e-3
    values = names["actuators"](physics_dt)["joint_1"]
    assert values["joint_names_expr"] == ["joint_1"]
    assert names["VELOCITY_TARGET"]["joint_1"] == 0.0
    delay = 0.5 * physics_dt * (values["min_delay"] + values["max_delay"])
    return ReadBack(
        values["stiffness"],
        values["damping"],
        delay,
        values["armature"],
        values["dynamic_friction"],
        values["viscous_friction"],
    )


def attributes(text: str, prim: str) -> dict[str, float]:
    """Numbers of a prim of a USD layer, by the names of its attributes."""
    body = re.search(rf'{prim} "joint_1".*?\{{(.*?)\}}', text, re.DOTALL)
    assert body is not None
    return {
        name: float(value)
        for name, value in re.findall(r"(?:float|int) (\S+) = (\S+)", body[1])
    }


def read_usd_drive(text: str) -> ReadBack:
    """The drive of USD Physics: angles are in degrees there."""
    values = attributes(text, "over")
    per_degree = np.pi / 180.0
    assert values["newton:damping"] == values[VISCOUS]
    return ReadBack(
        values["drive:angular:physics:stiffness"] / per_degree,
        values["drive:angular:physics:damping"] / per_degree,
        armature=values["newton:armature"],
        coulomb=values["newton:friction"],
        viscous=values["newton:damping"] / per_degree,
    )


def read_newton_actuator(text: str) -> ReadBack:
    """Newton's actuator: angles are in rad there, delays in steps of 5 ms."""
    values = attributes(text, "def NewtonActuator")
    assert "</driven/joints/joint_1>" in text
    return ReadBack(
        values["newton:kp"], values["newton:kd"], 5e-3 * values["newton:delaySteps"]
    )


READERS: dict[str, tuple[str, Callable[[str], ReadBack]]] = {
    "ros2_control": ("ros2-control", read_ros2_control),
    "isaac_lab": ("isaac-lab", read_isaac_lab),
    "usd_drive": ("usd", read_usd_drive),
    "newton_actuator": ("usd", read_newton_actuator),
}


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


@pytest.mark.slow
@pytest.mark.parametrize("form", READERS)
def test_what_a_form_says_moves_as_the_replay(
    tmp_path: Path, robot_file: Path, form: str
) -> None:
    """MuJoCo's plant, with the numbers of the form in place of its own."""
    target, reader = READERS[form]
    path, file = drive_file(tmp_path, robot_file)
    output = tmp_path / "written"
    result = export(path, robot_file, output, target=target)
    assert any("ms late" in note for note in result.notes)
    said = reader(output.read_text())

    joint = file.joints["joint_1"]
    assert said.stiffness == pytest.approx(joint.value("proportional"), rel=1e-5)
    assert said.damping == pytest.approx(joint.value("derivative"), rel=1e-5)
    delay = said.delay or joint.value("command_delay")
    assert delay == pytest.approx(joint.value("command_delay"), abs=2.5e-3)
    plant = driven()
    # Of one joint its rotor and its link are one inertia, wherever a form has it.
    for name in ("coulomb", "viscous"):
        value = getattr(said, name)
        if value is not None:
            assert value == pytest.approx(getattr(plant, name)[0], rel=0.05), name
            plant = replace(plant, **{name: np.array([value])})
    plant = plant.with_drive(
        proportional=np.array([said.stiffness]),
        derivative=np.array([said.damping]),
        command_delay=delay,
    )
    seconds = 3.0
    again = simulate_drive(plant, multisine(4, 1, 8.0), seconds, seed=4)
    off = again.q - log().q[: len(again.q)]
    error = float(np.sqrt(np.mean(off**2)))
    # A delay in whole steps is off by half a step, which counts with the speed.
    steps = abs(delay - joint.value("command_delay"))
    speed = float(np.sqrt(np.mean(np.gradient(log().q[:, 0], log().t) ** 2)))
    assert error < 2.0 * replay_error() + steps * speed + 2e-4


def test_a_usd_layer_is_read_by_its_library(tmp_path: Path, robot_file: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    path, file = drive_file(tmp_path, robot_file)
    output = tmp_path / "drive.usda"
    export(path, robot_file, output, target="usd")
    stage = usd.Stage.Open(str(output))
    prim = stage.GetPrimAtPath("/driven/joints/joint_1")
    stiffness = prim.GetAttribute("drive:angular:physics:stiffness").Get()
    gain = file.joints["joint_1"].value("proportional")
    assert stiffness == pytest.approx(gain * np.pi / 180.0, rel=1e-5)
    actuator = stage.GetPrimAtPath("/driven/actuators/joint_1")
    assert actuator.GetTypeName() == "NewtonActuator"
    targets = actuator.GetRelationship("newton:targets").GetTargets()
    assert [str(target) for target in targets] == ["/driven/joints/joint_1"]
