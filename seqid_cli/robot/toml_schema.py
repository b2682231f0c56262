"""`robot.toml` as typed data, `seqid/robot@1` (msgspec only).

Descriptions of the keys, with their units, go into the JSON Schema by which editors
complete and check the file.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SCHEMA = "seqid/robot@1"
SCHEMA_VERSION = 1

Vector = tuple[float, float, float]
# A pattern with {name}, {index} or {index0}, or the column of each joint: its name or
# number.
Columns = str | tuple[str | int, ...]

Quantity = Literal[
    "velocity",
    "torque",
    "current",
    "load",
    "link_position",
    "voltage",
    "pwm",
    "temperature",
]
_COLUMNS = (
    "a pattern such as 'joint_{index}.pos' with {name}, {index} (from 1) or {index0}"
    " (from 0), or a list of columns in the order of the joints"
)


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Base of all tables: an unknown key is an error that names its path."""


class DhEntry(Table, frozen=True):
    """Modified DH parameters of a joint (Craig, Eq. 27)."""

    alpha: Annotated[float, Meta(description="twist before the joint [rad]")]
    a: Annotated[float, Meta(description="length before the joint [m]")]
    d: Annotated[float, Meta(description="offset along the joint's axis [m]")]
    theta0: Annotated[float, Meta(description="angle where the position is 0 [rad]")]


class JointEntry(Table, frozen=True):
    """One `[[joint]]`, in the order of the chain."""

    name: Annotated[str, Meta(description="the URDF's name of it, where there is one")]
    prismatic: Annotated[
        bool,
        Meta(description="whether it slides: read m for rad and N for N m then"),
    ] = False
    dh: Annotated[
        DhEntry | None,
        Meta(description="modified DH parameters, where the file names no urdf"),
    ] = None
    torque_constant: Annotated[
        float | None,
        Meta(description="[N m/A] on the motor side, where logs carry current"),
    ] = None
    torque_constant_error: Annotated[
        float,
        Meta(
            description="relative standard error of torque constant and gear together,"
            " 0.02 for 2 %; exact where it is 0"
        ),
    ] = 0.0
    position_zero_error: Annotated[
        float, Meta(description="standard error of the joint's zero [rad]")
    ] = 0.0
    gear_ratio: Annotated[
        float | None,
        Meta(description="motor turns per joint turn, negative where it turns back"),
    ] = None
    rotor_inertia: Annotated[
        float | None,
        Meta(
            description="[kg m^2] on the motor side; identified where it is left out"
            " and motion tells it"
        ),
    ] = None
    winding_resistance: Annotated[
        float | None,
        Meta(description="[ohm], where logs carry voltage or duty cycle"),
    ] = None
    supply_voltage: Annotated[
        float | None, Meta(description="[V], where logs carry duty cycle")
    ] = None
    encoder_resolution: Annotated[
        float | None, Meta(description="[rad] per count, at the joint")
    ] = None
    encoder_side: Annotated[
        Literal["motor", "link"],
        Meta(
            description="'link' where positions are of an encoder behind the gear,"
            " which does not see the gear twist"
        ),
    ] = "motor"
    torque_side: Annotated[
        Literal["motor", "link"] | None,
        Meta(description="that of this joint, where it is not that of the robot"),
    ] = None
    position_limits: Annotated[
        tuple[float, float] | None, Meta(description="lowest and highest [rad]")
    ] = None
    velocity_limit: Annotated[float | None, Meta(description="[rad/s]")] = None


class AccelerometerEntry(Table, frozen=True):
    """One accelerometer of an `[[imu]]`, in the IMU's own frame."""

    position: Annotated[Vector, Meta(description="[m]")]
    axis: Annotated[Vector, Meta(description="direction in which it reads")]


class ImuEntry(Table, frozen=True):
    """One `[[imu]]`: an array of accelerometers, a triad, or a triad with a gyro."""

    name: Annotated[str, Meta(description="its channels begin with it")]
    after_joint: Annotated[
        str, Meta(description="the joint that moves the link on which it rides")
    ]
    accelerometers: Annotated[
        tuple[AccelerometerEntry, ...],
        Meta(description="a triad at the IMU's origin where none is listed"),
    ] = ()
    gyro: Annotated[bool, Meta(description="whether it has a gyro")] = False


class Interfaces(Table, frozen=True):
    """`interface`: names that a driver gives the values of a DynamicJointState."""

    position: Annotated[str | None, Meta(description="usually 'position'")] = None
    velocity: Annotated[str | None, Meta(description="usually 'velocity'")] = None
    torque: Annotated[
        str | None, Meta(description="usually 'effort' or 'torque' [N m at the joint]")
    ] = None
    current: Annotated[
        str | None, Meta(description="in place of torque [A on the motor side]")
    ] = None
    command: Annotated[
        str | None, Meta(description="the commanded position: 'position_command'")
    ] = None
    command_velocity: Annotated[str | None, Meta(description="likewise")] = None
    command_torque: Annotated[str | None, Meta(description="likewise")] = None


class Channels(Table, frozen=True):
    """`[channels]`: names that a log uses; None means the default."""

    topic: Annotated[
        str | None,
        Meta(
            description="topic of the joint states in MCAP files and bags, such as"
            " '/left/joint_states'"
        ),
    ] = None
    command_topic: Annotated[
        str | None,
        Meta(
            description="topic of the commands in MCAP files and bags, a JointState"
            " such as '/joint_commands'; states of joint trajectory controllers are"
            " found without it"
        ),
    ] = None
    namespace: Annotated[
        str | None,
        Meta(
            description="what stands before all topics of this robot, such as '/left',"
            " where a bag holds several robots"
        ),
    ] = None
    interface: Annotated[
        Interfaces | None,
        Meta(description="which values of a DynamicJointState are which quantity"),
    ] = None
    prefix: Annotated[
        str | None,
        Meta(description="what stands before the joints' names in the log: 'left_'"),
    ] = None
    names: Annotated[
        Columns | None,
        Meta(
            description="the joints' names in the log, in the order of the joints, or a"
            " pattern such as 'arm_{index}'; the robot file's where it is left out"
        ),
    ] = None

    time: Annotated[
        str | int | None, Meta(description="column of the time, by name or number")
    ] = None
    time_unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None,
        Meta(
            description="unit of numbers in the column of the time; as its name says,"
            " or s, where it is left out"
        ),
    ] = None
    rate: Annotated[
        float | None,
        Meta(description="[Hz] samples per second of tables without a column of time"),
    ] = None
    files: Annotated[
        dict[Quantity, str],
        Meta(
            description="the files beside that of the positions which hold the other"
            " quantities, such as { torque = 'tau.csv' }; found by their names without"
        ),
    ] = {}
    position: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    velocity: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    current: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    torque: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    load: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    link_position: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    voltage: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    pwm: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    temperature: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    command: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    command_velocity: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    command_torque: Annotated[Columns | None, Meta(description=_COLUMNS)] = None
    effort: Annotated[
        Literal["torque", "current", "gravity_compensated"] | None,
        Meta(description="what the effort of a JointState is"),
    ] = None
    unit: Annotated[
        Literal["rad", "deg", "turn", "count", "percent"],
        Meta(
            description="unit of positions and speeds; 'count': of encoder_resolution,"
            " 'percent': -100 and 100 are the ends of position_limits, as LeRobot may"
            " log it"
        ),
    ] = "rad"
    length_unit: Annotated[
        Literal["m", "mm"], Meta(description="unit of sliding joints' positions")
    ] = "m"

    @property
    def effort_is_current(self) -> bool:
        """True where the effort of a message is motor current [A]."""
        return self.effort == "current" or (
            self.interface is not None and self.interface.current is not None
        )


DEFAULTS = Channels()


class EffectEntry(Table, frozen=True):
    """One `[[effect]]` to look for beside the catalogue."""

    name: Annotated[
        str, Meta(description="its name, or that of an effect of an installed package")
    ]
    joint: Annotated[
        str | None, Meta(description="where it acts; at any joint if left out")
    ] = None
    torque: Annotated[
        str | None,
        Meta(
            description="its formula, such as 'c1 * tanh(q / width)'; left out where a"
            " package offers the effect"
        ),
    ] = None
    settings: Annotated[
        dict[str, tuple[float, float]],
        Meta(description="lowest and highest value of each setting of the formula"),
    ] = {}


class GeometryError(Table, frozen=True):
    """`geometry_error`: standard errors of each joint's frame in the chain."""

    position: Annotated[float, Meta(description="[m]")] = 0.0
    angle: Annotated[float, Meta(description="[rad]")] = 0.0


class RobotFile(Table, frozen=True):
    """The whole document."""

    schema: Annotated[str, Meta(description=f"'{SCHEMA}'")]
    name: Annotated[str, Meta(description="any name of the robot")]
    gravity: Annotated[Vector, Meta(description="in the base frame [m/s^2]")]
    joint: Annotated[
        tuple[JointEntry, ...], Meta(description="the joints from the base on")
    ]
    urdf: Annotated[
        str | None,
        Meta(description="path from this file; or give dh of every joint"),
    ] = None
    torque_side: Annotated[
        Literal["motor", "link"],
        Meta(
            description="'link' where the torques are of sensors behind the gears,"
            " which do not feel the rotors"
        ),
    ] = "motor"
    gravity_error: Annotated[
        float, Meta(description="standard error of gravity's direction [rad]")
    ] = 0.0
    geometry_error: Annotated[
        GeometryError,
        Meta(description="standard errors of each joint's frame in the chain"),
    ] = GeometryError()
    imu: tuple[ImuEntry, ...] = ()
    effect: tuple[EffectEntry, ...] = ()
    channels: Channels = DEFAULTS


TABLES: dict[str, type[Table]] = {  # by their keys in the document
    "joint": JointEntry,
    "joint.dh": DhEntry,
    "geometry_error": GeometryError,
    "imu": ImuEntry,
    "imu.accelerometers": AccelerometerEntry,
    "channels": Channels,
    "channels.interface": Interfaces,
    "effect": EffectEntry,
}


def column_name(pattern: Columns, joint: str, index0: int) -> str:
    """Fill a pattern with a joint's name and place, or look up its column in a list.

    In a pattern {name}, {index} (from 1) and {index0} (from 0) are replaced.
    """
    if not isinstance(pattern, str):
        return str(pattern[index0])
    numbered = pattern.replace("{index0}", str(index0))
    return numbered.replace("{index}", str(index0 + 1)).replace("{name}", joint)
