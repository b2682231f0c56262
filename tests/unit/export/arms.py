"""Arms to export, and what Pinocchio and MuJoCo make of them."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from seqid_cli.effects.fitted import FittedEffect, as_stage
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.export.formats import Exported, export
from seqid_cli.export.urdf_tree import bodies_of_urdf
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Array, Robot
from seqid_cli.robot.urdf import read_urdf_text
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_6R, NAMES_GANTRY, urdf_6r, urdf_gantry
from tests.plants.robots.stages import (
    random_bodies,
    save_robot,
    seven_joints,
    stages_of,
)

Arm = tuple[Robot, Stages]


def made(
    folder: Path, text: str, names: tuple[str, ...], seed: int, *, known: bool = False
) -> Arm:
    rng = np.random.default_rng(seed)
    extra = "gear_ratio = 50.0\n" + "rotor_inertia = 1e-4\n" * known
    robot = save_robot(folder, text, names, joint_extra=extra)
    rotor = np.zeros(robot.n) if known else np.full(robot.n, 1e-4)
    assert robot.urdf is not None
    bodies = bodies_of_urdf(read_urdf_text(robot.urdf), names)
    kept = np.array([body.locked_links for body in bodies])
    return robot, stages_of(robot, random_bodies(rng, robot.n) + kept, rotor)


def sample(rig: str) -> Arm:
    """A sample robot with bodies that exist; the real files are tested with the
    commands.
    """
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


def states(n: int) -> Array:
    """States (3, N, n): positions, velocities, accelerations."""
    return (
        np.random.default_rng(11).normal(size=(3, 25, n))
        * np.array([1.5, 2.0, 5.0])[:, None, None]
    )


def with_effect(
    name: str, joint: int, settings: dict[str, float], c: list[float]
) -> Arm:
    """The six-joint sample robot with one effect more."""
    robot, stages = sample("six_joint")
    item = FittedEffect(
        effect=CATALOGUE[name],
        joint=joint,
        settings=settings,
        coefficients=np.array(c),
        covariance=np.eye(len(c)),
    )
    stages.effects = [as_stage(item, robot)]
    return robot, stages


def written(arm: Arm, kind: str) -> Exported:
    return export(*arm, kind=kind)


def agree(found: Array, expected: Array, share: float = 1e-9) -> None:
    """Assert that torques are the same to a share of the largest."""
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=share * np.abs(expected).max()
    )


def rigid(arm: Arm) -> Array:
    robot, stages = arm
    return TorqueModel.from_stages(stages, robot).rigid(*states(robot.n))


def pinocchio_torque(robot: Robot, text: str, armature: Array) -> Array:
    """Torque by Pinocchio of a URDF, joints that are not the arm's locked at zero."""
    model = pin.buildModelFromXML(text)
    others = [
        k for k in range(1, model.njoints) if model.names[k] not in robot.joint_names
    ]
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
