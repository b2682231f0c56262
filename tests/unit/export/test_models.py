"""What other tools make of the model files: Pinocchio, MuJoCo, a YAML reader."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from ruamel.yaml import YAML

from seqid_cli.export.formats import export
from seqid_cli.export.model import ExportModel
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import inverse_dynamics
from tests.plants.robots.small import NAMES_6R, urdf_6r
from tests.plants.robots.stages import (
    inertia_stage,
    random_bodies,
    save_robot,
    stages_of,
)
from tests.unit.export.arms import (
    Arm,
    agree,
    made,
    mujoco_torque,
    pinocchio_torque,
    rigid,
    states,
    with_effect,
    written,
)


def test_pinocchio_finds_the_identified_torque_in_the_urdf(arm: Arm) -> None:
    done = written(arm, "URDF")
    assert done.model.nearest.exact
    check_bodies(done.model)
    agree(pinocchio_torque(arm[0], done.text, done.model.armature), rigid(arm))


def test_mujoco_finds_the_identified_torque_in_the_mjcf(arm: Arm) -> None:
    agree(mujoco_torque(arm[0], written(arm, "MJCF").text), rigid(arm), 1e-8)


def check_bodies(model: ExportModel) -> None:
    for phi in (*model.nearest.links, *model.bodies):
        J = pseudo_inertia(phi)
        assert np.linalg.eigvalsh(J)[0] > 1e-9 * np.trace(J)
    assert (model.nearest.rotor >= 0.0).all()


def test_ros2_parameters_read_back_as_the_same_bodies(arm: Arm) -> None:
    done = written(arm, "ROS 2 parameters")
    robot = arm[0]
    found = YAML(typ="safe").load(done.text)["/**"]["ros__parameters"]
    assert tuple(found["joints"]) == robot.joint_names
    phi, armature = [], []
    for name in robot.joint_names:
        group = found[name]
        own = np.zeros((3, 3))
        own[np.triu_indices(3)] = own.T[np.triu_indices(3)] = group["inertia"]
        body = pin.Inertia(group["mass"], np.array(group["center_of_mass"]), own)
        phi.append(body.toDynamicParameters())
        armature.append(group["armature"])
        assert all(isinstance(group[key], float) for key in ("mass", "armature"))
        assert set(group["friction"]) == {"coulomb", "viscous", "offset", "rms_misfit"}
    torque = inverse_dynamics(
        robot.chain, robot.gravity, np.array(phi), *states(robot.n)
    )
    agree(torque + armature * states(robot.n)[2], rigid(arm))


def test_the_solver_of_ros2_finds_its_chain_in_the_exported_urdf(arm: Arm) -> None:
    """KDL takes the joints from `root` to `tip` with the URDF's inertials, without
    armature.
    """
    robot = arm[0]
    parameters = YAML(typ="safe").load(written(arm, "ROS 2 parameters").text)["/**"]
    kdl = parameters["ros__parameters"]["kdl"]
    urdf = written(arm, "URDF")
    joints = ElementTree.fromstring(urdf.text).findall("joint")
    before = {joint.find("child").get("link"): joint for joint in joints}  # type: ignore[union-attr]
    at, chain = kdl["tip"], []
    while at != kdl["root"]:
        joint = before[at]
        chain.append((joint.get("name"), joint.get("type")))
        at = joint.find("parent").get("link")  # type: ignore[union-attr]
    assert (
        tuple(name for name, kind in reversed(chain) if kind != "fixed")
        == robot.joint_names
    )
    assert kdl["gravity"] == robot.gravity.tolist()
    torque = pinocchio_torque(robot, urdf.text, np.zeros(robot.n))
    expected = rigid(arm) - urdf.model.armature * states(robot.n)[2]
    if robot.n != 4:  # KDL leaves out what the gripper's fingers carry
        agree(torque, expected, 1e-8)


def test_ros2_control_commands_the_torque_of_every_joint(arm: Arm) -> None:
    done = written(arm, "URDF")
    (system,) = ElementTree.fromstring(done.text).findall("ros2_control")
    assert system.findtext("hardware/plugin") == "mock_components/GenericSystem"
    joints = system.findall("joint")
    assert tuple(joint.get("name") for joint in joints) == arm[0].joint_names
    for joint, armature, fit in zip(
        joints, done.model.armature, done.model.friction, strict=True
    ):
        assert [e.get("name") for e in joint.findall("command_interface")] == ["effort"]
        given = {e.get("name"): float(e.text or "") for e in joint.findall("param")}
        expected = {
            "armature": armature,
            "coulomb": fit.coulomb,
            "viscous": fit.viscous,
        }
        assert given == pytest.approx(expected)


def test_mujoco_rubs_as_the_exported_friction_does(arm: Arm) -> None:
    """With the torque of bodies and friction applied, MuJoCo's arm accelerates as it
    should.
    """
    done = written(arm, "MJCF")
    model = mujoco.MjModel.from_xml_string(done.text)
    for bit in ("LIMIT", "CONTACT"):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}")
    data = mujoco.MjData(model)
    fits = [fit for fit in done.model.friction if fit is not None]
    assert len(fits) == arm[0].n
    viscous, coulomb = np.array([(fit.viscous, fit.coulomb) for fit in fits]).T
    q, dq, ddq = states(arm[0].n)
    # no joint about to stick
    for x, v, a in zip(q, dq + 5.0 * np.sign(dq), ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = x, v, a
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_rne(model, data, 1, data.qfrc_applied)
        data.qfrc_applied[:] += (
            viscous * v + coulomb * np.sign(v) + model.dof_armature * a
        )
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, a, rtol=0, atol=1e-6 * np.abs(ddq).max())


OLD = int(mujoco.__version__.split(".")[0]) < 4
LINEAR_ONLY = pytest.mark.skipif(OLD, reason="MuJoCo before 4 has linear springs only")


@pytest.mark.parametrize(
    "law",
    [
        [30.0, -12.0],
        [-20.0, 3.0],
        pytest.param([30.0, -12.0, 4.0, 2.0], marks=LINEAR_ONLY),
    ],
    ids=["linear", "counterbalance", "cubic"],
)
def test_mujoco_pulls_at_a_spring_as_the_effect_does(law: list[float]) -> None:
    arm = with_effect("spring", 2, {"cubic": float(len(law) > 2)}, law)
    done = written(arm, "MJCF")
    assert "written as it is: spring (elbow)" in " ".join(done.model.notes)
    q = states(6)[0][:, 2]
    expected = rigid(arm)
    k, zero, cubic, squared = [*law, 0.0, 0.0][:4]
    expected[:, 2] += zero + k * q + squared * q**2 + cubic * q**3
    agree(mujoco_torque(arm[0], done.text), expected, 1e-8)


def test_mujoco_lets_the_link_fall_through_its_backlash() -> None:
    """The motor held still, the link rests on the flank to which gravity pulls it."""
    arm = with_effect("backlash", 1, {"trial_gap": 0.01}, [0.01])
    model = mujoco.MjModel.from_xml_string(written(arm, "MJCF").text)
    assert model.nv == 7
    data = mujoco.MjData(model)
    motors = [model.joint(name).id for name in arm[0].joint_names]
    gap = model.joint(f"{arm[0].joint_names[1]}_backlash").id
    model.dof_armature[motors] = 1e6  # they stay where they are
    for side in (-1.0, 1.0):
        mujoco.mj_resetData(model, data)
        data.qpos[motors] = [0.0, 0.3, 0.0, 0.0, 0.0, 0.0]
        data.qfrc_applied[gap] = side * 300.0
        for _ in range(1000):
            mujoco.mj_step(model, data)
        assert data.qpos[gap] == pytest.approx(side * 0.005, abs=0.0005)


def test_what_no_body_has_is_projected_and_reported(tmp_path: Path) -> None:
    robot, stages = made(tmp_path, urdf_6r(), NAMES_6R, 9, known=True)
    names = np.array([p.name for p in stages.inertia.parameters])
    # the last link would turn the other way
    shift = np.where(names == "Izz_6", -3000.0, 0.0)
    rng = np.random.default_rng(9)
    stages.inertia = inertia_stage(robot, random_bodies(rng, robot.n), shift=shift)
    done = export(robot, stages, kind="URDF")
    model = done.model
    assert not model.nearest.exact
    assert model.largest_deviation > 10.0
    own = inverse_dynamics(robot.chain, robot.gravity, model.bodies, *states(robot.n))
    own += model.armature * states(robot.n)[2]
    agree(pinocchio_torque(robot, done.text, model.armature), own)
    told = next(d for d in model.deviations if d.name == "Izz_6")
    assert told.exported > told.identified
    assert "Izz_6: identified" in done.text
    check_bodies(model)


def test_a_gravity_file_takes_inertias_from_the_urdf(tmp_path: Path) -> None:
    robot, stages = made(tmp_path, urdf_6r(), NAMES_6R, 12, known=True)
    assert stages.inertia is not None
    gravity = stages.inertia
    own = [k for k, p in enumerate(gravity.parameters) if p.unit == "kg m"]
    gravity.parameters = [gravity.parameters[k] for k in own]
    gravity.covariance = [[gravity.covariance[i][j] for j in own] for i in own]
    done = export(robot, Stages(gravity=gravity), kind="URDF")
    assert done.model.nearest.exact
    assert any("no inertia stage" in note for note in done.model.notes)
    zero = np.zeros((25, robot.n))
    q = states(robot.n)[0]
    expected = TorqueModel.from_stages(Stages(gravity=gravity), robot).rigid(
        q, zero, zero
    )
    found = inverse_dynamics(
        robot.chain, robot.gravity, done.model.bodies, q, zero, zero
    )
    agree(found, expected)


def test_what_torque_does_not_show_stays_as_in_the_cad(tmp_path: Path) -> None:
    """Where the CAD itself has the identified torque, it comes out unchanged."""
    robot = save_robot(tmp_path, urdf_6r(), NAMES_6R, joint_extra="gear_ratio = 50.0\n")
    stages = stages_of(robot, robot.nominal)
    model = export(robot, stages, kind="URDF").model
    np.testing.assert_allclose(
        model.bodies, robot.nominal, atol=1e-3 * robot.nominal.max()
    )
    assert all(model.nearest.from_cad)
