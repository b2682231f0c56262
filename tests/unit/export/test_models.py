"""What other tools make of the exported files: Pinocchio, MuJoCo, a C compiler, a YAML reader."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from ruamel.yaml import YAML

from seqid_cli.export.c_header import identifier
from seqid_cli.export.formats import Exported, export
from seqid_cli.export.urdf_tree import bodies_of_urdf
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_6R, NAMES_GANTRY, urdf_6r, urdf_gantry
from tests.plants.robots.stages import (
    SAMPLES,
    friction_stage,
    inertia_stage,
    random_bodies,
    save_robot,
    seven_joints,
    stages_of,
)

Arm = tuple[Robot, Stages]


def made(folder: Path, text: str, names: tuple[str, ...], seed: int, *, known: bool = False) -> Arm:
    rng = np.random.default_rng(seed)
    extra = "gear_ratio = 50.0\n" + "rotor_inertia = 1e-4\n" * known
    robot = save_robot(folder, text, names, joint_extra=extra)
    rotor = np.zeros(robot.n) if known else np.full(robot.n, 1e-4)
    kept = np.array([body.kept for body in bodies_of_urdf(ElementTree.fromstring(text), names)])
    return robot, stages_of(robot, random_bodies(rng, robot.n) + kept, rotor)


def sample(rig: str) -> Arm:
    """A sample robot with bodies that exist; the real files are tested with the commands."""
    rng = np.random.default_rng(len(rig))
    robot = sample_robot(rig)
    phi = random_bodies(rng, robot.n) if robot.nominal is None else 0.9 * robot.nominal
    return robot, stages_of(robot, phi)


ARMS: dict[str, Callable[[Path], Arm]] = {
    "one_joint": lambda _: sample("one_joint"),
    "two_joint": lambda _: sample("two_joint"),
    "six_joint": lambda _: sample("six_joint"),
    "seven": lambda folder: made(folder, *seven_joints(np.random.default_rng(3)), 4),
    "gantry": lambda folder: made(folder, urdf_gantry(), NAMES_GANTRY, 5),
    "tool": lambda folder: made(folder, urdf_6r(), NAMES_6R, 6, known=True),
    "gripper": lambda folder: made(folder, urdf_6r(), NAMES_6R[:4], 7),
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Arm:
    return ARMS[request.param](tmp_path)


def states(n: int) -> Array:
    """States (3, N, n): positions, velocities, accelerations."""
    return (
        np.random.default_rng(11).normal(size=(3, 25, n)) * np.array([1.5, 2.0, 5.0])[:, None, None]
    )


def written(arm: Arm, kind: str) -> Exported:
    robot, stages = arm
    return export(robot, stages, kind=kind)


def rigid(arm: Arm) -> Array:
    robot, stages = arm
    return TorqueModel.from_stages(stages, robot).rigid(*states(robot.n))


def pinocchio_torque(robot: Robot, text: str, armature: Array) -> Array:
    """Torque by Pinocchio of a URDF, joints that are not the arm's locked at zero."""
    model = pin.buildModelFromXML(text)
    others = [k for k in range(1, model.njoints) if model.names[k] not in robot.joint_names]
    model = pin.buildReducedModel(model, others, pin.neutral(model))
    assert tuple(model.names)[1:] == robot.joint_names
    model.gravity.linear = robot.gravity
    model.armature = armature
    data, start = model.createData(), pin.neutral(model)
    q, dq, ddq = states(robot.n)
    rows = [
        pin.rnea(model, data, pin.integrate(model, start, x), v, a).copy()
        for x, v, a in zip(q, dq, ddq, strict=True)
    ]
    return np.reshape(rows, q.shape)


def mujoco_torque(robot: Robot, text: str) -> Array:
    """Torque by MuJoCo's inverse dynamics, without friction, limits and contacts."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    model.dof_damping[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    rows = []
    for x, v, a in zip(*states(robot.n), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = x, v, a
        mujoco.mj_inverse(model, data)
        rows.append(data.qfrc_inverse.copy())
    return np.array(rows)


def test_pinocchio_finds_the_identified_torque_in_the_urdf(arm: Arm) -> None:
    done = written(arm, "URDF")
    assert done.model.exact
    torque = pinocchio_torque(arm[0], done.text, done.model.armature)
    np.testing.assert_allclose(torque, rigid(arm), rtol=0, atol=1e-9 * np.abs(torque).max())


def test_mujoco_finds_the_identified_torque_in_the_mjcf(arm: Arm) -> None:
    torque = mujoco_torque(arm[0], written(arm, "MJCF").text)
    np.testing.assert_allclose(torque, rigid(arm), rtol=0, atol=1e-8 * np.abs(torque).max())


@pytest.mark.parametrize("rig", ["one_joint", "two_joint"])
def test_models_identified_from_the_sample_logs_keep_their_torque(rig: str) -> None:
    robot = sample_robot(rig)
    arm = (robot, read_parameters(SAMPLES / rig / "golden.json").stages)
    expected = rigid(arm)
    done = written(arm, "URDF")
    assert done.model.exact
    torque = pinocchio_torque(robot, done.text, done.model.armature)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    torque = mujoco_torque(robot, written(arm, "MJCF").text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_every_link_is_a_body_that_can_exist(arm: Arm) -> None:
    model = written(arm, "URDF").model
    for own, whole in zip(model.own, model.bodies, strict=True):
        for phi in (own, whole):
            J = pseudo_inertia(phi)
            assert np.linalg.eigvalsh(J)[0] > 1e-9 * np.trace(J)
    assert (model.rotor >= 0.0).all()


def c_torques(folder: Path, robot: Robot, text: str) -> Array:
    """Compile the header and run it over the states."""
    name, n = identifier(robot.name), robot.n
    (folder / "arm.h").write_text(text)
    read = 'for (i = 0; i < N; ++i) if (scanf("%lf", &{0}[i]) != 1) return {1};'
    (folder / "main.c").write_text(
        f'#include <stdio.h>\n#include "arm.h"\nenum {{ N = {n} }};\n'
        "int main(void) { double q[N], dq[N], ddq[N], tau[N]; int i; for (;;) {\n"
        f"{read.format('q', 0)}\n{read.format('dq', 1)}\n{read.format('ddq', 1)}\n"
        f'{name}_torque(q, dq, ddq, tau);\nfor (i = 0; i < N; ++i) printf("%.17g ", tau[i]);'
        '\nprintf("\\n"); } }\n'
    )
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    compiler = shutil.which("cc") or "cc"
    command = [compiler, *flags, "-o", str(folder / "main"), str(folder / "main.c"), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    rows = np.concatenate(states(n), axis=1)
    typed = "\n".join(" ".join(f"{x!r}" for x in row) for row in rows.tolist())
    ran = subprocess.run(
        [str(folder / "main")], input=typed, capture_output=True, text=True, check=True
    )
    return np.array([[float(word) for word in line.split()] for line in ran.stdout.splitlines()])


needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


@needs_cc
def test_the_c_header_computes_the_predicted_torque(arm: Arm, tmp_path: Path) -> None:
    robot, stages = arm
    q, dq, ddq = states(robot.n)
    model = TorqueModel.from_stages(stages, robot)
    expected = model.rigid(q, dq, ddq) + model.friction(q, dq)
    torque = c_torques(tmp_path, robot, written(arm, "C header").text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@needs_cc
@pytest.mark.parametrize("log", [False, True])
def test_the_c_header_keeps_directions_speed_scales_and_coupled_rotors(
    tmp_path: Path, log: bool
) -> None:
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 8, known=True)
    assert stages.inertia is not None
    stages.inertia.rotor_coupling = "gyroscopic"
    stages.friction = friction_stage(robot, directional=True, log=log)
    stages.friction.joints.pop("reach")
    q, dq, ddq = states(robot.n)
    model = TorqueModel.from_stages(stages, robot)
    expected = model.rigid(q, dq, ddq) + model.friction(q, dq)
    done = export(robot, stages, kind="C header")
    torque = c_torques(tmp_path, robot, done.text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_ros2_parameters_read_back_as_the_same_bodies(arm: Arm) -> None:
    done = written(arm, "ROS 2 parameters")
    robot = arm[0]
    found = YAML(typ="safe").load(done.text)["/**"]["ros__parameters"]
    assert tuple(found["joints"]) == robot.joint_names
    phi, armature = [], []
    for name in robot.joint_names:
        group = found[name]
        mass, c = group["mass"], np.array(group["center_of_mass"])
        xx, xy, xz, yy, yz, zz = group["inertia"]
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about = own + mass * (c @ c * np.eye(3) - np.outer(c, c))
        entries = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        phi.append([mass, *(mass * c), *entries])
        armature.append(group["armature"])
        assert all(isinstance(group[key], float) for key in ("mass", "armature"))
        assert set(group["friction"]) == {"coulomb", "viscous", "offset", "rms_misfit"}
    q, dq, ddq = states(robot.n)
    chain = robot.chain
    torque = inverse_dynamics(chain, robot.gravity, np.array(phi), q, dq, ddq) + armature * ddq
    np.testing.assert_allclose(torque, rigid(arm), rtol=0, atol=1e-9 * np.abs(torque).max())


def test_what_no_body_has_is_projected_and_reported(tmp_path: Path) -> None:
    robot, stages = made(tmp_path, urdf_6r(), NAMES_6R, 9, known=True)
    assert stages.inertia is not None
    names = np.array([p.name for p in stages.inertia.parameters])
    shift = np.where(names == "Izz_6", -3000.0, 0.0)  # the last link would turn the other way
    rng = np.random.default_rng(9)
    stages.inertia = inertia_stage(robot, random_bodies(rng, robot.n), shift=shift)
    done = export(robot, stages, kind="URDF")
    model = done.model
    assert not model.exact
    assert model.largest_deviation > 10.0
    torque = pinocchio_torque(robot, done.text, model.armature)
    q, dq, ddq = states(robot.n)
    own = inverse_dynamics(robot.chain, robot.gravity, model.bodies, q, dq, ddq)
    own += model.armature * ddq
    np.testing.assert_allclose(torque, own, rtol=0, atol=1e-9 * np.abs(torque).max())
    told = next(d for d in model.deviations if d.name == "Izz_6")
    assert told.exported > told.identified
    assert "Izz_6: identified" in done.text
    for phi in model.own:
        assert np.linalg.eigvalsh(pseudo_inertia(phi))[0] > 0.0


def test_projection_is_no_farther_than_bodies_that_are_known_to_exist(tmp_path: Path) -> None:
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 10)
    assert stages.inertia is not None
    names = [p.name for p in stages.inertia.parameters]
    shift = np.where(np.array(names) == "Izz_4", -2000.0, 0.0)
    rng = np.random.default_rng(10)
    phi = random_bodies(rng, robot.n)
    stages.inertia = inertia_stage(robot, phi, np.full(robot.n, 1e-4), shift=shift)
    near = export(robot, stages, kind="URDF").model
    stages.inertia = inertia_stage(robot, phi, np.full(robot.n, 1e-4))
    true = export(robot, stages, kind="URDF").model
    chi2 = sum((d.std_errors or 0.0) ** 2 for d in near.deviations)
    feasible = sum(float(s) ** 2 for s in shift)  # the bodies the shift was taken from
    assert true.exact
    assert 0.0 < chi2 < feasible + 1.0


def test_a_gravity_file_takes_inertias_from_the_urdf(tmp_path: Path) -> None:
    robot, stages = made(tmp_path, urdf_6r(), NAMES_6R, 12, known=True)
    assert stages.inertia is not None
    gravity = stages.inertia
    own = [k for k, p in enumerate(gravity.parameters) if p.unit == "kg m"]
    gravity.parameters = [gravity.parameters[k] for k in own]
    gravity.covariance = [[gravity.covariance[i][j] for j in own] for i in own]
    done = export(robot, Stages(gravity=gravity), kind="URDF")
    assert done.model.exact
    assert any("no inertia stage" in note for note in done.model.notes)
    zero = np.zeros((25, robot.n))
    q = states(robot.n)[0]
    expected = TorqueModel.from_stages(Stages(gravity=gravity), robot).rigid(q, zero, zero)
    found = inverse_dynamics(robot.chain, robot.gravity, done.model.bodies, q, zero, zero)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_what_torque_does_not_show_stays_as_in_the_cad(tmp_path: Path) -> None:
    """Where the CAD itself has the identified torque, it comes out unchanged."""
    text, names = urdf_6r(), NAMES_6R
    robot = save_robot(tmp_path, text, names, joint_extra="gear_ratio = 50.0\n")
    assert robot.nominal is not None
    stages = stages_of(robot, robot.nominal)
    model = export(robot, stages, kind="URDF").model
    np.testing.assert_allclose(model.bodies, robot.nominal, atol=1e-3 * robot.nominal.max())
    assert all(model.from_cad)


def test_a_robot_of_no_inertials_gets_links_of_the_right_size() -> None:
    robot, stages = sample("two_joint")
    model = export(replace(robot, nominal=None), stages, kind="MJCF").model
    assert not any(model.from_cad)
    reach = np.linalg.norm(model.own[:, 1:4], axis=1) / model.own[:, 0]
    assert (reach < 1.0).all()
    assert (model.own[:, 0] > 0.01).all()
    assert (model.own[:, 0] < 100.0).all()
