"""A made-up arm like the SO-101, logged as by LeRobot.

    python -m tests.plants.so101 FOLDER

Six hobby servos hold the last of 50 goals a second, 20 ms late. A data set has goals
(`action`) and positions (`observation.state`) in degrees at 50 Hz, rounded to the 4096
counts of a turn, and no torque. `so101.urdf` has the links alone: no rotors, and no
friction.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.logs.recording import Recording
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Joint, Robot
from tests.plants.driven import DH, Drive, DrivenArm, multisine, simulate_drive
from tests.plants.mechanics.rigid import placement

NAMES = (
    "shoulder_pan",
    "shoulder_lift",
    "elbow_flex",
    "wrist_flex",
    "wrist_roll",
    "gripper",
)
RATE_HZ = 50.0
COUNT_RAD = 2.0 * np.pi / 4096.0
SECONDS = 30.0
# Seeds of the episodes.
SETS = {"train": (21, 22, 23), "held": (31,)}
HIGHEST_HZ = 2.0  # of the motions


def arm() -> DrivenArm:
    """The arm: light links, and servos with strong friction and a rotor that counts."""
    n = len(NAMES)
    joints = tuple(Joint(name) for name in NAMES)
    gravity = np.array([0.0, 0.0, -9.81])
    path = Path("robot.toml")
    robot = Robot("so101", joints, chain_from_dh(DH), gravity, "", path)
    mass = np.array([0.15, 0.12, 0.12, 0.1, 0.06, 0.03])
    phi = np.zeros((n, 10))
    for j in range(n):
        com = np.array([0.05, 0.01, 0.0])
        own = mass[j] * np.diag([4e-4, 6e-4, 6e-4])
        about_origin = own + mass[j] * (com @ com * np.eye(3) - np.outer(com, com))
        phi[j, 0] = mass[j]
        phi[j, 1:4] = mass[j] * com
        phi[j, 4:] = about_origin[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    nothing = np.zeros(n)
    drive = Drive(
        proportional=np.array([18.0, 20.0, 19.0, 17.0, 17.0, 16.0]),
        derivative=np.array([1.2, 1.5, 1.3, 0.9, 0.8, 0.7]),
        integral=nothing,
        velocity_feedforward=nothing,
        gravity_compensation=nothing,
        command_delay=0.02,
        torque_lag=0.0,
        torque_limit=np.full(n, np.inf),
    )
    return DrivenArm(
        robot=robot,
        phi=phi,
        armature=np.full(n, 0.028),
        coulomb=np.array([0.08, 0.1, 0.09, 0.06, 0.05, 0.04]),
        viscous=np.full(n, 0.02),
        drive=drive,
    )


def urdf_of(of: DrivenArm) -> str:
    """Write the links as a URDF."""
    parts = ['<robot name="so101">\n<link name="base"/>\n']
    for j, name in enumerate(of.robot.joint_names):
        parent = f"link_{j}" if j else "base"
        rotation, origin = placement(np.array(DH[j]))
        rpy = pin.rpy.matrixToRpy(rotation)
        mass = of.phi[j, 0]
        com = of.phi[j, 1:4] / mass
        xx, xy, yy, xz, yz, zz = of.phi[j, 4:]
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))
        parts.append(
            f'<link name="link_{j + 1}"><inertial><origin xyz="{_text(com)}"/>'
            f'<mass value="{mass}"/><inertia ixx="{inertia[0, 0]:.9g}"'
            f' ixy="{inertia[0, 1]:.9g}" ixz="{inertia[0, 2]:.9g}"'
            f' iyy="{inertia[1, 1]:.9g}" iyz="{inertia[1, 2]:.9g}"'
            f' izz="{inertia[2, 2]:.9g}"/></inertial></link>\n'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{j + 1}"/>'
            f'<origin xyz="{_text(origin)}" rpy="{_text(rpy)}"/><axis xyz="0 0 1"/>'
            '<limit lower="-2.5" upper="2.5" velocity="10" effort="3"/></joint>\n'
        )
    return "".join([*parts, "</robot>\n"])


def _text(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def episode(of: DrivenArm, seed: int) -> Recording:
    """Record one episode, positions in counts."""
    n = of.robot.n
    moves = multisine(seed, n, SECONDS, size=0.8, highest_hz=HIGHEST_HZ)
    log = simulate_drive(
        of, moves, SECONDS, seed=seed, rate_hz=RATE_HZ, command_hz=RATE_HZ, noise=0.0
    )
    return replace(log, q=COUNT_RAD * np.rint(log.q / COUNT_RAD))


def write_data_set(folder: Path, episodes: Sequence[Recording]) -> None:
    """Write episodes as LeRobot does: one table, and names in `meta/info.json`."""
    tables = []
    for number, log in enumerate(episodes):
        assert log.command is not None
        rows = np.arange(len(log.t))
        columns = {
            "action": list(np.rad2deg(log.command).astype(np.float32)),
            "observation.state": list(np.rad2deg(log.q).astype(np.float32)),
            "timestamp": log.t.astype(np.float32),
            "frame_index": rows,
            "episode_index": np.full(len(rows), number),
            "index": rows,
            "task_index": np.zeros_like(rows),
        }
        tables.append(pa.table(columns))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    pq.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    names = {"dtype": "float32", "names": [f"{name}.pos" for name in NAMES]}
    info = {"fps": 50, "features": {"action": names, "observation.state": names}}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")


def make(folder: Path) -> None:
    """Write the URDF and both data sets."""
    of = arm()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "so101.urdf").write_text(urdf_of(of), encoding="utf-8")
    for name, seeds in SETS.items():
        write_data_set(folder / name, [episode(of, seed) for seed in seeds])


if __name__ == "__main__":
    make(Path(sys.argv[1]))
