"""Small robots, written as a lab would write them, and Pinocchio as the oracle."""

from pathlib import Path

import numpy as np
import pinocchio as pin

from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Array, Chain, Joint, Robot
from tests.plants.arms.rigs import UR5E_DH
from tests.plants.arms.rigs import UR5E_NAMES as NAMES_6R

HALF = float(np.pi / 2)
GRAVITY = np.array([0.0, 0.0, -9.81])

# Modified DH (alpha, a, d) of a UR5e-like arm; as URDF: rpy = alpha 0 0, xyz = a, -sin
# d, cos d.
ARM_6R = tuple(tuple(float(x) for x in row[:3]) for row in UR5E_DH)


def robot_from_chain(
    chain: Chain, *, gravity: Array = GRAVITY, gear_ratio: float | None = None
) -> Robot:
    joints = tuple(
        Joint(f"joint_{k + 1}", prismatic=bool(slides), gear_ratio=gear_ratio)
        for k, slides in enumerate(chain.prismatic)
    )
    return Robot(
        "test", joints, chain, np.asarray(gravity, dtype=float), "", Path("robot.toml")
    )


def arm_6r(*, gear_ratio: float | None = None) -> Robot:
    return robot_from_chain(
        chain_from_dh([(*row, 0.0) for row in ARM_6R]), gear_ratio=gear_ratio
    )


def planar_2r() -> Robot:
    """Return the arm of Sec. 4.2: two vertical axes, l_1 = 0.3 m."""
    chain = chain_from_dh([(0.0, 0.0, 0.0, 0.0), (0.0, 0.3, 0.0, 0.0)])
    return robot_from_chain(chain, gear_ratio=6.0)


def link(
    name: str, *, mass: float | None = None, x: float = 0.0, mesh: str = ""
) -> str:
    inertial = (
        f'<inertial><origin xyz="{x} 0.02 -0.01" rpy="0.1 0.2 0.3"/><mass'
        f' value="{mass}"/><inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03"'
        ' iyz="0.003" izz="0.04"/></inertial>'
    )
    geometry = f'<geometry><mesh filename="{mesh}"/></geometry>'
    visual = f"<visual>{geometry}</visual><collision>{geometry}</collision>"
    parts = (inertial if mass is not None else "") + (visual if mesh else "")
    return f'<link name="{name}">{parts}</link>'


def joint(
    name: str, parent: str, child: str, *, kind: str = "revolute", **own: str
) -> str:
    """A joint at `xyz` and `rpy` about `axis`, and what is `extra` in it."""
    own = {"xyz": "0 0 0", "rpy": "0 0 0", "axis": "0 0 1", "extra": ""} | own
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child'
        f' link="{child}"/><origin xyz="{{xyz}}" rpy="{{rpy}}"/><axis'
        ' xyz="{axis}"/><limit lower="-3" upper="3" effort="100"'
        ' velocity="3"/>{extra}</joint>'.format(**own)
    )


def urdf(*parts: str) -> str:
    return f'<?xml version="1.0"?>\n<robot name="r">{"".join(parts)}</robot>\n'


def urdf_6r() -> str:
    """Write the UR5e-like arm: continuous joints, a fixed tool, absent meshes,
    transmissions.
    """
    parts = [link("base", mass=4.0, mesh="package://nowhere/base.dae")]
    parent = "base"
    for k, (name, (alpha, a, d)) in enumerate(zip(NAMES_6R, ARM_6R, strict=True)):
        child = f"link_{k + 1}"
        xyz = f"{a!r} {float(-np.sin(alpha) * d)!r} {float(np.cos(alpha) * d)!r}"
        kind = "continuous" if k in {0, 5} else "revolute"
        parts.append(
            link(child, mass=5.0 / (k + 1), x=0.1 * k, mesh=f"nowhere/{child}.stl")
        )
        parts.append(
            joint(name, parent, child, kind=kind, xyz=xyz, rpy=f"{alpha!r} 0 0")
        )
        parts.append(
            "<transmission"
            f' name="t{k}"><type>transmission_interface/SimpleTransmission</type>'
            "<joint"
            f' name="{name}"><hardwareInterface>Effort</hardwareInterface></joint>'
            "<actuator"
            f' name="m{k}"><mechanicalReduction>101</mechanicalReduction></actuator>'
            "</transmission>"
        )
        parent = child
    parts.append(link("tool", mass=0.3, x=0.05))
    parts.append(
        joint("tool_mount", parent, "tool", kind="fixed", xyz="0 0 0.1", rpy="0 0.5 0")
    )
    return urdf(*parts)


def urdf_gantry() -> str:
    """Write a slide, a turn about y, a slide along a skew axis and a turn; one link has
    no mass.
    """
    return urdf(
        link("base"),
        link("l1", mass=3.0, x=0.1),
        link("l2", mass=2.0, x=-0.1),
        link("l3"),
        link("l4", mass=1.0, x=0.2),
        joint("rail", "base", "l1", kind="prismatic", axis="1 0 0", xyz="0 0 0.5"),
        joint("swing", "l1", "l2", axis="0 1 0", xyz="0.1 0.2 0", rpy="0.3 -0.2 0.9"),
        joint("reach", "l2", "l3", kind="prismatic", axis="0.6 0 0.8", xyz="0.2 0 0.1"),
        joint("twist", "l3", "l4", kind="continuous", axis="0 0 -1", rpy="0 0 0.4"),
    )


NAMES_GANTRY = ("rail", "swing", "reach", "twist")


def random_model(
    rng: np.random.Generator, prismatic: list[bool]
) -> tuple[pin.Model, Chain]:
    """Draw a serial arm with random axes and inertias, as Pinocchio's model and as a
    Chain.
    """
    model, parent, rotations, positions, axes = pin.Model(), 0, [], [], []
    for k, slides in enumerate(prismatic):
        axis, quaternion = rng.normal(size=3), rng.normal(size=4)
        axis /= np.linalg.norm(axis)
        turn = pin.Quaternion(
            quaternion / np.linalg.norm(quaternion)
        ).toRotationMatrix()
        placement = pin.SE3(turn, rng.normal(size=3))
        kind = (
            pin.JointModelPrismaticUnaligned
            if slides
            else pin.JointModelRevoluteUnaligned
        )
        parent = model.addJoint(parent, kind(axis), placement, f"j{k}")
        model.appendBodyToJoint(parent, random_inertia(rng), pin.SE3.Identity())
        rotations.append(turn)
        positions.append(placement.translation.copy())
        axes.append(axis)
    chain = Chain(
        np.array(rotations), np.array(positions), np.array(axes), np.array(prismatic)
    )
    return model, chain


def random_inertia(rng: np.random.Generator) -> pin.Inertia:
    A = rng.normal(size=(3, 3))
    return pin.Inertia(
        float(rng.uniform(0.1, 5.0)), rng.normal(size=3), A @ A.T + np.eye(3)
    )


def states(
    rng: np.random.Generator, samples: int, n: int
) -> tuple[Array, Array, Array]:
    q, dq, ddq = rng.normal(size=(3, samples, n))
    return 2.0 * q, dq, 3.0 * ddq


def oracle_regressor(model: pin.Model, q: Array, dq: Array, ddq: Array) -> Array:
    """Loop Pinocchio's regressor over samples; joints must have one coordinate each."""
    data = model.createData()
    rows = [
        pin.computeJointTorqueRegressor(model, data, *state).copy()
        for state in zip(q, dq, ddq, strict=True)
    ]
    return np.reshape(rows, (*q.shape, -1))  # of one joint Pinocchio gives a bare row
