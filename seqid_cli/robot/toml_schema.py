"""`robot.toml` as typed data, `seqid/robot@1` (msgspec only)."""

from typing import Literal

import msgspec

SCHEMA = "seqid/robot@1"
SCHEMA_VERSION = 1

Vector = tuple[float, float, float]
# A pattern with {name}, {index} or {index0}, or the column of each joint: its name or
# number.
Columns = str | tuple[str | int, ...]


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Base of all tables: an unknown key is an error that names its path."""


class DhEntry(Table, frozen=True):
    """Modified DH parameters of a joint, rad and m."""

    alpha: float
    a: float
    d: float
    theta0: float


class JointEntry(Table, frozen=True):
    """One `[[joint]]`."""

    name: str
    prismatic: bool = False
    dh: DhEntry | None = None
    torque_constant: float | None = None
    torque_constant_error: float = 0.0
    position_zero_error: float = 0.0
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    winding_resistance: float | None = None
    supply_voltage: float | None = None
    encoder_resolution: float | None = None
    encoder_side: Literal["motor", "link"] = "motor"
    position_limits: tuple[float, float] | None = None
    velocity_limit: float | None = None


class AccelerometerEntry(Table, frozen=True):
    """One accelerometer of an `[[imu]]`, in the IMU's own frame."""

    position: Vector
    axis: Vector


class ImuEntry(Table, frozen=True):
    """One `[[imu]]`."""

    name: str
    after_joint: str
    accelerometers: tuple[AccelerometerEntry, ...] = ()
    gyro: bool = False


class Channels(Table, frozen=True):
    """`[channels]`: names that a log uses; None means the default."""

    time: str | int | None = None
    position: Columns | None = None
    velocity: Columns | None = None
    current: Columns | None = None
    torque: Columns | None = None
    load: Columns | None = None
    link_position: Columns | None = None
    voltage: Columns | None = None
    pwm: Columns | None = None
    temperature: Columns | None = None
    # what the effort of a JointState is
    effort: Literal["torque", "current", "gravity_compensated"] | None = None
    unit: Literal["rad", "deg"] = "rad"  # of angles
    length_unit: Literal["m", "mm"] = "m"  # of sliding joints' positions


class EffectEntry(Table, frozen=True):
    """One `[[effect]]`: a formula, or the name of an effect of an installed package."""

    name: str
    joint: str | None = None
    torque: str | None = None
    settings: dict[str, tuple[float, float]] = {}


class GeometryError(Table, frozen=True):
    """`geometry_error`: standard errors of each joint's frame in the chain."""

    position: float = 0.0  # m
    angle: float = 0.0  # rad


class RobotFile(Table, frozen=True):
    """The whole document."""

    schema: str
    name: str
    gravity: Vector
    joint: tuple[JointEntry, ...]
    urdf: str | None = None
    gravity_error: float = 0.0
    geometry_error: GeometryError = GeometryError()
    imu: tuple[ImuEntry, ...] = ()
    effect: tuple[EffectEntry, ...] = ()
    channels: Channels = Channels()


TABLES: dict[str, type[Table]] = {  # by their keys in the document
    "joint": JointEntry,
    "joint.dh": DhEntry,
    "geometry_error": GeometryError,
    "imu": ImuEntry,
    "imu.accelerometers": AccelerometerEntry,
    "channels": Channels,
    "effect": EffectEntry,
}
