"""Robots and motions for the tests of the readers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.raw import RawLog
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Channels, Imu, Joint, Robot
from tests import Array
from tests.plants.robots.small import robot_from_chain
from tests.unit.logs.writers import write_mcap, write_parquet

JOINTS = ("shoulder", "elbow", "wrist")
ARRAY = Imu("array", 1, np.zeros((6, 3)), np.tile(np.eye(3), (2, 1)))
GYRO = Imu("hand", 2, np.zeros((3, 3)), np.eye(3), gyro=True)


def make_robot(
    names: Sequence[str] = JOINTS,
    *,
    imus: Sequence[Imu] = (),
    constants: Sequence[float | None] | float | None = None,
    gear_ratio: float | None = None,
    channels: Channels | None = None,
) -> Robot:
    """Build a robot whose kinematics do not matter."""
    each = zip(names, np.broadcast_to(constants, len(names)).tolist(), strict=True)
    joints = tuple(
        Joint(name, torque_constant=k, gear_ratio=gear_ratio) for name, k in each
    )
    robot = robot_from_chain(chain_from_dh([(0.0, 0.0, 0.0, 0.0)] * len(names)))
    return replace(
        robot, joints=joints, imus=tuple(imus), channels=channels or Channels()
    )


@dataclass(frozen=True)
class Motion:
    """What a log shall hold: t (N,) s, the rest (N, n), (N, K) or (N, 3)."""

    t: Array
    q: Array
    dq: Array
    tau: Array
    accelerometers: dict[str, Array] = field(default_factory=dict)
    gyros: dict[str, Array] = field(default_factory=dict)


def curve(t: Array, width: int, shift: float = 0.0) -> Array:
    k = np.arange(width)
    return np.sin((1.0 + 0.3 * k) * t[:, None] + 0.7 * k + shift)


def make_motion(t: Array, n: int = 3) -> Motion:
    gravity = np.array([0.0, 0.0, 9.81] * 2)
    q, dq, tau = curve(t, n), curve(t, n, 0.5) * 1.3, curve(t, n, 1.0) * 20.0
    accelerometers = {
        "array": curve(t, 6) + gravity,
        "hand": curve(t, 3, 2.0) + gravity[:3],
    }
    return Motion(t, q, dq, tau, accelerometers, {"hand": curve(t, 3, 3.0)})


def write_motion(path: Path, motion: Motion, **options: Any) -> Path:
    """Write all of a motion, efforts as torque, as MCAP or Parquet by the suffix."""
    more: dict[str, Any] = {
        "accelerometers": motion.accelerometers,
        "gyros": motion.gyros,
    }
    more |= {"dq": motion.dq, **options}
    if path.suffix == ".mcap":
        more = {"encoding": "cdr", "effort": motion.tau} | more
        return write_mcap(path, motion.t, JOINTS, motion.q, **more)
    return write_parquet(path, motion.t, JOINTS, motion.q, torque=motion.tau, **more)


def grid(count: int = 200, rate_hz: float = 100.0) -> Array:
    return np.arange(count) / rate_hz


def read_raw(path: Path, robot: Robot) -> RawLog:
    """Read a log as it was logged, as one block."""
    return LogFile.at(path).whole(robot)
