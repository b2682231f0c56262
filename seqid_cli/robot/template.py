"""A commented `robot.toml` from known values, with TODO for what the user must add."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from seqid_cli.robot.toml_schema import SCHEMA, Columns
from seqid_cli.templates import filled

if TYPE_CHECKING:
    from seqid_cli.robot.types import Imu


@dataclass(frozen=True, kw_only=True)
class JointTemplate:
    """Values of a joint; None where they are not known."""

    name: str
    limits: tuple[float, float] | None = None  # rad (m)
    velocity: float | None = None  # rad/s (m/s), the largest
    encoder_step: float | None = None  # rad (m)
    moves: bool = True
    remark: str = ""
    torque_constant: float | None = None  # N m/A
    gear_ratio: float | None = None


@dataclass(frozen=True, kw_only=True)
class RobotTemplate:
    """The content of the file."""

    name: str
    joints: tuple[JointTemplate, ...]
    urdf: str | None = None  # the path to write; None for a DH stub
    # of the log: "torque", "current", "effort" where it does not say, or empty
    effort: str = ""
    imus: tuple["Imu", ...] = ()
    channels: Mapping[str, Columns] = field(default_factory=dict)
    rate: float | None = None  # Hz, of logs without a column of time
    left_out: tuple[str, ...] = ()  # joints of the URDF that are not in the log
    # whether positions are in degrees or in percent, which the log does not tell
    may_be_percent: bool = False


def robot_toml(template: RobotTemplate) -> str:
    """Write the text of a robot file; `templates/robot.toml.j2` is its form."""
    filters = {
        "text": json.dumps,
        "number": _number,
        "comment": _comment,
        "pattern": partial(json.dumps, ensure_ascii=False),
    }
    content = {**vars(template), "schema": SCHEMA}
    return filled("seqid_cli.robot", "robot.toml.j2", content, filters=filters)


def _number(value: float, digits: int) -> str:
    """Write a number as TOML's float: with a point or an exponent."""
    text = f"{value:.{digits}g}"
    return text if "." in text or "e" in text else f"{text}.0"


def _comment(text: str) -> str:
    """Replace what cannot be printed, a line's end above all, in a comment."""
    return "".join(char if char.isprintable() else "?" for char in text)
