"""The robot as every other layer sees it: frozen data, no file formats, no Pinocchio."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from seqid_cli.robot.formula import Formula
from seqid_cli.robot.toml_schema import Channels
from seqid_cli.robot.urdf import UrdfJoint
from seqid_cli.typing import Array as Array
from seqid_cli.typing import Mask
from seqid_cli.units import unit_of


@dataclass(frozen=True)
class Joint:
    """One actuated joint of the chain (rad and N m; m and N where prismatic).

    `torque_constant` [N m/A] and `rotor_inertia` [kg m^2] are on the motor side;
    `winding_resistance` [ohm] and `supply_voltage` [V] are for logs of voltage or duty cycle.
    `torque_constant_error` is the relative standard error of the joint's torque scale.
    `encoder_side` tells which side of the gear the positions are of. `urdf` holds what the URDF
    says of the joint, None where there is none.
    """

    name: str
    prismatic: bool = False
    torque_constant: float | None = None
    torque_constant_error: float = 0.0
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    winding_resistance: float | None = None
    supply_voltage: float | None = None
    encoder_resolution: float | None = None
    encoder_side: Literal["motor", "link"] = "motor"
    position_limits: tuple[float, float] | None = None
    velocity_limit: float | None = None
    urdf: UrdfJoint | None = None

    @property
    def torque_per_ampere(self) -> float | None:
        """Joint torque per motor current, N m/A."""
        if self.torque_constant is None:
            return None
        return self.torque_constant * (self.gear_ratio or 1.0)

    def unit(self, unit: str) -> str:
        """Return the joint's own unit for one that is written as for a revolute joint."""
        return unit_of(unit, self.prismatic)


@dataclass(frozen=True)
class Imu:
    """An accelerometer array, or an ordinary IMU, riding on the link after a joint.

    `positions` (K, 3) m and `axes` (K, 3) unit vectors are in the IMU's own frame. An ordinary IMU
    (triad, with or without gyro) has three orthogonal axes at its origin.
    """

    name: str
    after_joint: int
    positions: Array
    axes: Array
    gyro: bool = False


@dataclass(frozen=True)
class Chain:
    """Kinematic constants of a serial chain of n joints.

    At q = 0 joint i's frame is `rotation[i]` (3, 3), `position[i]` (3,) m in the frame of joint i-1
    (of the base for i = 0). `axis[i]` (3,) is the unit axis in joint i's own frame.
    """

    rotation: Array  # (n, 3, 3)
    position: Array  # (n, 3)
    axis: Array  # (n, 3)
    prismatic: Mask  # (n,)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.prismatic)


@dataclass(frozen=True)
class OwnEffect:
    """An effect that the robot file adds to the catalogue: a formula, or a package's (None).

    `joint` is where it is looked for, None for everywhere; `settings` have their limits.
    """

    name: str
    joint: int | None = None
    formula: Formula | None = None
    settings: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot file, read and checked, with its URDF (`urdf`, None where it names none).

    `gravity` (3,) m/s^2 in the base frame. `nominal` (n, 10) are the standard inertial parameters
    of the URDF, if it has any, in Pinocchio's order (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz),
    inertia about the joint frame's origin.
    """

    name: str
    joints: tuple[Joint, ...]
    chain: Chain
    gravity: Array
    sha256: str
    source: Path
    imus: tuple[Imu, ...] = ()
    channels: Channels = field(default_factory=Channels)
    nominal: Array | None = None
    urdf: Path | None = None
    effects: tuple[OwnEffect, ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def torque_constant_errors(self) -> Array:
        """Relative standard errors (n,) of the joints' torque scales."""
        return np.array([joint.torque_constant_error for joint in self.joints])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in chain order."""
        return tuple(joint.name for joint in self.joints)

    def name_of(self, joint: int | None) -> str | None:
        """A joint's name; None for the whole arm."""
        return None if joint is None else self.joints[joint].name
