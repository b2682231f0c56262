"""The robot as all other rooms see it: frozen data, no file formats, no Pinocchio."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from seqid_cli.robot.formula import Formula
from seqid_cli.robot.toml_schema import Channels, column_name
from seqid_cli.robot.urdf import UrdfJoint
from seqid_cli.typing import Array as Array
from seqid_cli.typing import Mask
from seqid_cli.units import unit_of


@dataclass(frozen=True)
class Joint:
    """One actuated joint of the chain (rad and N m; m and N where prismatic)."""

    name: str
    _: KW_ONLY
    prismatic: bool = False
    torque_constant: float | None = None  # N m/A, motor side
    # relative standard error of the joint's torque scale
    torque_constant_error: float = 0.0
    position_zero_error: float = 0.0  # rad (m), standard error of the joint's zero
    gear_ratio: float | None = None
    rotor_inertia: float | None = None  # kg m^2, motor side
    # ohm; as the voltage for logs of voltage or duty cycle
    winding_resistance: float | None = None
    supply_voltage: float | None = None  # V
    encoder_resolution: float | None = None  # rad (m) at the joint
    # side of the gear whose positions the encoder reports
    encoder_side: Literal["motor", "link"] = "motor"
    position_limits: tuple[float, float] | None = None  # rad (m)
    velocity_limit: float | None = None  # rad/s (m/s)
    urdf: UrdfJoint | None = None  # what the URDF says of the joint

    @property
    def torque_per_ampere(self) -> float | None:
        """Joint torque per motor current, N m/A; None without a torque constant."""
        if self.torque_constant is None:
            return None
        return self.torque_constant * (self.gear_ratio or 1.0)

    def unit(self, unit: str) -> str:
        """Return the joint's unit for one that is written as for a revolute joint."""
        return unit_of(unit, self.prismatic)


@dataclass(frozen=True)
class LockedJoint:
    """A joint that carries the arm and is not in the robot file: taken as locked."""

    joint: Joint
    place: str  # in words: between which joints

    @property
    def name(self) -> str:
        """Name of the joint in the URDF."""
        return self.joint.name

    @property
    def prismatic(self) -> bool:
        """True for a joint that slides."""
        return self.joint.prismatic


@dataclass(frozen=True)
class Imu:
    """An accelerometer array, or an ordinary IMU, riding on the link after a joint."""

    name: str
    after_joint: int  # 0-based: it rides on the link that this joint moves
    positions: Array  # (K, 3) m in the IMU's own frame
    # (K, 3) unit vectors; an ordinary IMU has three orthogonal ones at its origin
    axes: Array
    gyro: bool = False


@dataclass(frozen=True, eq=False)  # one and the same, not alike: arrays have no hash
class Chain:
    """Kinematic constants of a serial chain of n joints."""

    # (n, 3, 3) joints' frames at q = 0 in that of the joint before or the base
    rotation: Array
    position: Array  # (n, 3) m, their origins
    axis: Array  # (n, 3) unit axis in the joint's own frame
    prismatic: Mask  # (n,)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.prismatic)


@dataclass(frozen=True)
class OwnEffect:
    """An effect that the robot file adds to the catalogue."""

    name: str
    joint: int | None = None  # 0-based, where it is looked for; None: everywhere
    formula: Formula | None = None  # None: an installed package offers it
    # lowest and highest value of each setting that is searched
    settings: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A robot file, read and checked, with its URDF, if it names one."""

    name: str
    joints: tuple[Joint, ...]
    chain: Chain
    gravity: Array  # (3,) m/s^2 in the base frame
    sha256: str
    source: Path
    _: KW_ONLY
    imus: tuple[Imu, ...] = ()
    channels: Channels = field(default_factory=Channels)
    # (n, 10) of the URDF, if it has any, in Pinocchio's order (m, mx, my, mz, Ixx, Ixy,
    # Iyy, Ixz, Iyz, Izz), inertia about the joint frame's origin.
    nominal: Array | None = None
    urdf: Path | None = None
    effects: tuple[OwnEffect, ...] = ()
    # Standard errors of what no log shows: gravity's direction, each joint's frame in
    # the chain.
    gravity_error: float = 0.0  # rad, about either axis across it
    geometry_error_m: float = 0.0
    geometry_error_rad: float = 0.0
    locked: tuple[LockedJoint, ...] = ()  # of the URDF's chain up to the last joint
    # Joints that the robot file names and the arm does without: they mimic another.
    followers: tuple[UrdfJoint, ...] = ()

    def __repr__(self) -> str:
        """Return one line: the robot's name and its joints."""
        return f"<Robot {self.name}: {', '.join(self.joint_names)}>"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def log_names(self) -> tuple[str, ...]:
        """Joint names in chain order as logs have them."""
        pattern = self.channels.names or f"{self.channels.prefix or ''}{{name}}"
        return tuple(
            column_name(pattern, name, k) for k, name in enumerate(self.joint_names)
        )

    @property
    def torque_constant_errors(self) -> Array:
        """Relative standard errors (n,) of the joints' torque scales."""
        return np.array([joint.torque_constant_error for joint in self.joints])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in chain order."""
        return tuple(joint.name for joint in self.joints)

    def name_of(self, joint: int | None) -> str | None:
        """Return a joint's name; None for the whole arm."""
        return None if joint is None else self.joints[joint].name
