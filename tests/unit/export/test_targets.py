"""Forms of controllers and simulators: what their readers find in them."""

import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from ruamel.yaml import YAML

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.export import export
from seqid_cli.export.formats import ALL, BY_TARGET, format_of
from seqid_cli.export.targets import BANDWIDTH_HZ, safe_scales
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    Measured,
    PayloadFile,
)
from seqid_cli.params.schema import SCHEMA, ParameterFile
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.sample import SAMPLES
from tests.unit.export.arms import ARMS, Arm, sample, with_effect, written

SIX = SAMPLES / "six_joint" / "robot.toml"
LOAD = [2.0, 0.02, -0.04, 0.1, 0.03, 0.001, 0.028, 0.0, 0.002, 0.012]


def text_of(arm: Arm, target: str) -> str:
    return written(arm, BY_TARGET[target].title).text


@pytest.fixture
def six() -> Arm:
    return sample("six_joint")


def parameter_file(arm: Arm) -> ParameterFile:
    robot, stages = arm
    return ParameterFile(
        **head(SCHEMA, now()), robot=robot_id(robot), inputs=[], stages=stages
    )


def test_a_target_is_chosen_whatever_the_suffix() -> None:
    assert format_of(Path("x.json"), "ur-friction") == "UR friction model parameters"
    assert format_of(Path("x.json"), "c") == format_of(Path("arm.h"))
    with pytest.raises(UsageError, match="no target is named 'abb'") as caught:
        format_of(Path("x.json"), "abb")
    assert "franka-load" in caught.value.hint
    with pytest.raises(UsageError) as caught:
        format_of(Path("x.json"))
    assert "--target" in caught.value.hint


def test_names_of_forms_are_their_own() -> None:
    suffixes = [suffix for form in ALL for suffix in form.suffixes]
    assert len(set(suffixes)) == len(suffixes)
    assert len(BY_TARGET) == len(ALL)


def test_ur_friction_is_a_request_of_its_service(six: Arm) -> None:
    request = json.loads(text_of(six, "ur-friction"))
    assert set(request) == {"parameters"}
    for key in ("viscous_scale", "coulomb_scale"):
        scales = request["parameters"][key]
        assert len(scales) == 6
        assert all(0.0 < scale <= 1.0 for scale in scales)


def test_ur_friction_never_compensates_more_than_there_is(six: Arm) -> None:
    done = written(six, BY_TARGET["ur-friction"].title)
    for fit, surface in zip(done.model.friction, done.model.surfaces, strict=True):
        assert fit is not None
        assert isinstance(surface, FrictionSurface)
        coulomb, viscous = safe_scales(fit, surface)
        q, v = np.meshgrid(
            np.linspace(*surface.scaling.position, 40),
            np.linspace(*surface.scaling.speed, 40),
        )
        held = coulomb * fit.coulomb + viscous * fit.viscous * v.ravel()
        for way in (1.0, -1.0):
            friction = way * surface.torque(q.ravel(), way * v.ravel())
            assert np.mean(held > friction + 1e-9) < 0.15


def test_ur_friction_is_of_six_joints() -> None:
    with pytest.raises(ConfigError, match="six joints"):
        text_of(sample("two_joint"), "ur-friction")


def test_ros2_control_feeds_viscous_friction_forward(six: Arm) -> None:
    robot = six[0]
    done = written(six, BY_TARGET["ros2-control"].title)
    found = YAML(typ="safe").load(done.text)
    manager = found["controller_manager"]["ros__parameters"]
    assert manager["joint_trajectory_controller"]["type"].endswith(
        "/JointTrajectoryController"
    )
    follower = found["joint_trajectory_controller"]["ros__parameters"]
    assert tuple(follower["joints"]) == robot.joint_names
    assert follower["command_interfaces"] == ["effort"]
    for name, fit in zip(robot.joint_names, done.model.friction, strict=True):
        gains = follower["gains"][name]
        assert gains["ff_velocity_scale"] == pytest.approx(fit.viscous)
        assert set(gains) == {"p", "i", "d", "ff_velocity_scale"}
        assert gains["p"] > 0.0
    forward = found["feed_forward_controller"]["ros__parameters"]
    assert forward == {"joints": list(robot.joint_names), "interface_name": "effort"}


def test_usd_is_per_degree_where_joints_turn(tmp_path: Path) -> None:
    arm = ARMS["gantry"](tmp_path)
    done = written(arm, BY_TARGET["usd"].title)
    blocks = done.text.split('over "')[3:]
    assert len(blocks) == arm[0].n
    for block, joint, fit, armature in zip(
        blocks, arm[0].joints, done.model.friction, done.model.armature, strict=True
    ):
        assert block.startswith(f'{joint.name}"')
        found = {
            line.split(" = ")[0].split()[-1]: float(line.split(" = ")[1])
            for line in block.splitlines()
            if line.strip().startswith("float")
        }
        axis = "linear" if joint.prismatic else "angular"
        per_unit = 1.0 if joint.prismatic else np.pi / 180.0
        assert found[f"physxJointAxis:{axis}:armature"] == pytest.approx(armature)
        assert found[f"physxJointAxis:{axis}:dynamicFrictionEffort"] == pytest.approx(
            fit.coulomb
        )
        static = found[f"physxJointAxis:{axis}:staticFrictionEffort"]
        assert static >= fit.coulomb
        viscous = found[f"physxJointAxis:{axis}:viscousFrictionCoefficient"]
        assert viscous == pytest.approx(per_unit * fit.viscous)
        assert found["newton:damping"] == viscous
        assert found["newton:friction"] == pytest.approx(fit.coulomb)


def test_isaac_lab_takes_the_groups_of_an_actuator(six: Arm) -> None:
    done = written(six, BY_TARGET["isaac-lab"].title)
    module = ModuleType("actuator")
    exec(compile(done.text, "actuator.py", "exec"), module.__dict__)
    actuator = module.ACTUATOR
    assert tuple(actuator["joint_names_expr"]) == six[0].joint_names
    for name, fit in zip(six[0].joint_names, done.model.friction, strict=True):
        assert actuator["dynamic_friction"][name] == pytest.approx(fit.coulomb)
        assert actuator["viscous_friction"][name] == pytest.approx(fit.viscous)
        assert actuator["friction"][name] >= fit.coulomb


def test_mujoco_holds_a_position_as_stiffly_as_it_says(six: Arm) -> None:
    model = mujoco.MjModel.from_xml_string(text_of(six, "mujoco-position"))
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    data.ctrl[:] = 0.1
    for _ in range(int(4.0 / BANDWIDTH_HZ / model.opt.timestep)):
        mujoco.mj_step(model, data)
    stuck = model.dof_frictionloss / model.actuator_gainprm[:, 0]
    assert (np.abs(data.qpos - 0.1) <= 1.2 * stuck + 0.01).all()


def test_a_dc_motor_brakes_as_its_constants_say() -> None:
    robot, stages = sample("six_joint")
    joints = tuple(
        replace(joint, torque_constant=0.1, winding_resistance=0.5, supply_voltage=48.0)
        for joint in robot.joints
    )
    arm = replace(robot, joints=joints)
    model = mujoco.MjModel.from_xml_string(text_of((arm, stages), "mujoco-dcmotor"))
    data = mujoco.MjData(model)
    data.ctrl[:] = 24.0
    speed, ratio = 0.3, robot.joints[0].gear_ratio or 1.0
    data.qvel[0] = speed
    mujoco.mj_forward(model, data)
    expected = ratio * 0.1 * (24.0 - 0.1 * ratio * speed) / 0.5
    assert data.qfrc_actuator[0] == pytest.approx(expected)
    assert model.actuator_ctrlrange[0].tolist() == [-48.0, 48.0]


def test_a_dc_motor_needs_its_drive_data(six: Arm) -> None:
    with pytest.raises(ConfigError, match="winding_resistance"):
        text_of(six, "mujoco-dcmotor")


def load_of(tmp_path: Path, content: ParameterFile | PayloadFile, target: str) -> str:
    path = tmp_path / "load.json"
    write_json_atomic(path, content)
    export(path, SIX, tmp_path / "out", target=target)
    return (tmp_path / "out").read_text(encoding="utf-8")


def test_a_payload_effect_becomes_the_robots_own_setting(tmp_path: Path) -> None:
    file = parameter_file(with_effect("payload", 0, {"from_log": 0.0}, LOAD))
    for entry in file.stages.effects or []:
        entry.joint = None
    script = load_of(tmp_path, file, "ur-payload")
    assert script.startswith("set_target_payload(2, [0.01, -0.02, 0.05], [")
    franka = load_of(tmp_path, file, "franka-load")
    assert franka.startswith("robot.setLoad(2, {0.01, -0.02, 0.05}, {")
    assert franka.rstrip().endswith("});")


def test_a_payload_result_is_written_as_it_is(tmp_path: Path) -> None:
    robot: Robot = load_robot(SIX)
    known = Measured(value=1.0, std_error=0.1, unit="kg")
    result = PayloadFile(
        **head(PAYLOAD_SCHEMA, now()),
        robot=robot_id(robot),
        inputs=[],
        models=[],
        payload=CarriedBodyEntry(
            frame="flange", mass=known, center_of_mass=[known] * 3
        ),
        parameters=[],
        covariance=[],
        settings={"urscript": "set_payload(1.0, [0.1, 0.1, 0.1])"},
        joints={},
    )
    assert (
        load_of(tmp_path, result, "ur-payload") == "set_payload(1.0, [0.1, 0.1, 0.1])\n"
    )
    with pytest.raises(ConfigError, match="not determined"):
        load_of(tmp_path, result, "franka-load")


def test_a_file_without_a_load_is_refused(tmp_path: Path, six: Arm) -> None:
    with pytest.raises(ConfigError, match="no payload effect"):
        load_of(tmp_path, parameter_file(six), "franka-load")


def test_limits_of_collisions_are_in_the_result(tmp_path: Path, six: Arm) -> None:
    file = parameter_file(six)
    assert file.stages.inertia is not None
    file.stages.inertia.rmse = dict.fromkeys(six[0].joint_names, 0.5)
    done = export(file, SIX, tmp_path / "arm.h", no_replay=True)
    assert done.observer_gain is not None
    assert set(done.collision) == set(six[0].joint_names)
    for limits in done.collision.values():
        assert limits.limit is not None
        assert limits.limit > 0.5
        assert limits.stiction > 0.0
