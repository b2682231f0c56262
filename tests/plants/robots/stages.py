"""Arms to export: robot files on disk, and parameter files of bodies that exist."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from seqid_cli.identify.rigid.parameters import parameters_of, representative_of
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Array, Robot
from tests import ROOT
from tests.plants.robots.made import friction_joint
from tests.plants.robots.small import joint, link, urdf

SAMPLES = ROOT / "sample_logs"


def save_robot(
    folder: Path, text: str, names: tuple[str, ...], *, joint_extra: str = ""
) -> Robot:
    (folder / "arm.urdf").write_text(text)
    tables = "".join(f'[[joint]]\nname = "{name}"\n{joint_extra}' for name in names)
    (folder / "robot.toml").write_text(
        'schema = "seqid/robot@1"\nname = "arm"\nurdf = "arm.urdf"\n'
        f"gravity = [0.0, 0.0, -9.81]\n{tables}"
    )
    return load_robot(folder / "robot.toml")


def seven_joints(rng: np.random.Generator) -> tuple[str, tuple[str, ...]]:
    """Write a URDF of seven joints about axes in any direction,
    one fixed in between.
    """
    names = tuple(f"j{k}" for k in range(7))
    parts, parent = [link("base", mass=3.0)], "base"
    for k, name in enumerate(names):
        axis = rng.normal(size=3)
        if k == 3:
            parts += [
                link("flange", mass=0.4, x=0.03),
                joint(
                    "mount",
                    parent,
                    "flange",
                    kind="fixed",
                    xyz="0 0.1 0.05",
                    rpy="0.2 0 0.7",
                ),
            ]
            parent = "flange"
        xyz, rpy = (
            " ".join(f"{x:.6f}" for x in v) for v in 0.4 * rng.normal(size=(2, 3))
        )
        parts += [
            link(f"l{k}", mass=4.0 / (k + 1), x=0.05),
            joint(
                name,
                parent,
                f"l{k}",
                xyz=xyz,
                rpy=rpy,
                axis=" ".join(f"{x:.6f}" for x in axis),
            ),
        ]
        parent = f"l{k}"
    return urdf(*parts), names


def random_bodies(rng: np.random.Generator, n: int) -> Array:
    """Draw standard parameters (n, 10) of bodies that exist."""
    rows = []
    for _ in range(n):
        points, mass = 0.1 * rng.normal(size=(8, 3)), float(rng.uniform(0.5, 5.0))
        spread = points.T @ points / 8.0
        inertia = mass * (np.trace(spread) * np.eye(3) - spread)
        rows.append(
            pin.Inertia(mass, 0.1 * rng.normal(size=3), inertia).toDynamicParameters()
        )
    return np.array(rows)


def inertia_stage(
    robot: Robot,
    phi: Array,
    rotor: Array | float = 0.0,
    *,
    error: float = 1e-3,
    shift: Array | float = 0.0,
) -> RigidStage:
    """Write base parameters of known bodies (n, 10) as an inertia stage that holds all
    of them.
    """
    basis = free_basis(robot)
    values = basis.expression @ np.concatenate([phi.ravel(), np.zeros(robot.n) + rotor])
    errors = error * (np.abs(values) + 0.1 * np.abs(values).max())
    values, covariance = values + shift * errors, np.diag(errors**2)
    known = np.array([joint.rotor_inertia or 0.0 for joint in robot.joints])
    return RigidStage(
        parameters=parameters_of(
            robot, basis, np.arange(basis.size), values, covariance
        ),
        condition=1.0,
        rank=basis.size,
        structural_rank=basis.size,
        representative=representative_of(basis, values, known),
        covariance=covariance.tolist(),
    )


def friction_stage(
    robot: Robot, *, directional: bool = False, log: bool = False
) -> FrictionStage:
    """Friction surfaces of orders (2, 3), different for each joint."""
    rng = np.random.default_rng(5)
    joints = {}
    for name in robot.joint_names:
        forward = 0.1 * rng.normal(size=(3, 4))
        forward[0, :2] += [2.0, 0.5]
        backward = forward + 0.1 * rng.normal(size=(3, 4)) * directional
        count = 12 * (1 + directional)
        own = {
            "covariance": (1e-4 * np.eye(count)).tolist(),
            "directional": directional,
        }
        own |= {"speed_scale": "log" if log else "linear", "sign_width": 0.005}
        own |= {"position_range": [-2.0, 2.5], "speed_range": [0.05, 2.0]}
        joints[name] = friction_joint(forward, backward, max_error=0.1, rmse=0.1, **own)
    return FrictionStage(joints=joints)


def stages_of(
    robot: Robot, phi: Array, rotor: Array | float = 0.0, **more: Any
) -> Stages:
    return Stages(
        friction=friction_stage(robot), inertia=inertia_stage(robot, phi, rotor, **more)
    )
