"""A seven-joint arm and long logs of it for the measurements."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.identify.rigid.simultaneous_equations import surface_entries
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.small import urdf
from tests.plants.robots.stages import save_robot

N = 7
RATE_HZ = 1000.0
RESOLUTION = 2 * np.pi / 2**20
GROUP = 131_072
TORQUE_NOISE = 0.3
COULOMB, VISCOUS, FASTEST, SIGN_WIDTH = 2.0, 1.5, 6.0, 0.02

# Where each joint sits in the frame of the one before: xyz [m] and quarters of a roll;
# axes are z.
PLACES = (
    "0 0 0.333",
    "0 0 0",
    "0 -0.316 0",
    "0.0825 0 0",
    "-0.0825 0.384 0",
    "0 0 0",
    "0.088 0 0",
)
ROLLS = (0, -1, 1, 1, -1, 1, 1)
JOINTS = tuple(f"joint_{i + 1}" for i in range(N))


def write_arm(folder: Path) -> Path:
    links = ['<link name="base"/>']
    for i, (xyz, roll) in enumerate(zip(PLACES, ROLLS, strict=True)):
        mass, size = 4.0 - 0.45 * i, 0.05 - 0.006 * i
        links.append(
            f'<link name="link_{i}"><inertial><origin xyz="0.01 {0.02 * (-1) ** i}'
            f' 0.04"/><mass value="{mass}"/><inertia ixx="{size}" iyy="{0.9 * size}"'
            f' izz="{0.6 * size}" ixy="{0.05 * size}" ixz="{-0.04 * size}"'
            f' iyz="{0.03 * size}"/></inertial></link>'
        )
        parent = "base" if i == 0 else f"link_{i - 1}"
        links.append(
            f'<joint name="{JOINTS[i]}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{i}"/><origin xyz="{xyz}" '
            f'rpy="{roll * np.pi / 2} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="100"/></joint>'
        )
    extra = (
        "gear_ratio = 100.0\nrotor_inertia = 0.0\nencoder_resolution ="
        f" {RESOLUTION!r}\n"
    )
    save_robot(folder, urdf(*links), JOINTS, joint_extra=extra)
    return folder / "robot.toml"


def known_friction() -> Stages:
    """The friction of the logs, as a stage of orders (0, 1)."""
    ahead, back = surface_entries(FASTEST, 2)
    values, covariance = (
        np.array([COULOMB, VISCOUS]),
        ahead @ np.diag([1e-4, 1e-4]) @ ahead.T,
    )
    own = {"speed_range": [0.0, FASTEST], "sign_width": SIGN_WIDTH}
    joint = friction_joint(
        [ahead @ values], [back @ values], covariance=covariance.tolist(), **own
    )
    return Stages(friction=FrictionStage(joints=dict.fromkeys(JOINTS, joint)))


def known_model(robot: Robot, share: float = 1.0) -> Stages:
    """The friction that its logs have, and a share of the URDF's bodies."""
    values = np.concatenate([share * robot.nominal.ravel(), np.zeros(robot.n)])
    names = standard_names(robot.n)
    representative = dict(zip(names, values.tolist(), strict=True))
    inertia = RigidStage(
        parameters=[], condition=1.0, rank=1, representative=representative
    )
    return Stages(friction=known_friction().friction, inertia=inertia)


def motion(t: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (M, 7) at times t [s]."""
    w = 2 * np.pi * np.arange(1, 9) / 10.0
    size = np.random.default_rng(5).normal(size=(2, len(w), N)) * 0.15
    sine, cosine = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    # Every period is a little different, so that a long log is not one period many
    # times.
    slow = 1 + 0.2 * np.sin(2 * np.pi * t[:, None] / 313.0)
    q = slow * (sine @ size[0] + cosine @ size[1])
    dq = slow * (cosine @ (w[:, None] * size[0]) - sine @ (w[:, None] * size[1]))
    ddq = -slow * (
        sine @ (w[:, None] ** 2 * size[0]) + cosine @ (w[:, None] ** 2 * size[1])
    )
    rate = 0.2 * 2 * np.pi / 313.0 * np.cos(2 * np.pi * t[:, None] / 313.0)
    return q, dq + rate * q / slow, ddq + 2 * rate * dq / slow


def write_log(path: Path, robot: Robot, rows: int) -> Path:
    """Write a Parquet log: time, position and torque, in row groups of 131,072."""
    assert robot.nominal is not None
    rng, writer = np.random.default_rng(6), None
    for first in range(0, rows, GROUP):
        t = (first + np.arange(min(GROUP, rows - first))) / RATE_HZ
        q, dq, ddq = motion(t)
        tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
        tau += (COULOMB + VISCOUS * np.abs(dq)) * np.tanh(dq / SIGN_WIDTH)
        tau += TORQUE_NOISE * rng.normal(size=tau.shape)
        channels = {"position": RESOLUTION * np.round(q / RESOLUTION), "torque": tau}
        columns = {
            f"{x}.{k}": v[:, j]
            for k, v in channels.items()
            for j, x in enumerate(JOINTS)
        }
        table = pa.table({"t": t} | columns)
        writer = writer or pq.ParquetWriter(path, table.schema, compression="zstd")
        writer.write_table(table)
    if writer is not None:
        writer.close()
    return path
