"""Entries of the robot file by which a user declares what no log shows: their only
place here.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Tolerance:
    """An entry that declares one kind of imperfection, with one standard error of its
    sizes.

    `of_joint` says that it stands in every joint's table.
    """

    entry: str
    of_joint: bool = False


TOLERANCES: Mapping[str, Tolerance] = {
    "constant": Tolerance("torque_constant_error = 0.04", of_joint=True),
    "geometry": Tolerance("geometry_error = { position = 0.003, angle = 0.01 }"),
    "gravity": Tolerance("gravity_error = 0.02"),
    "zero": Tolerance("position_zero_error = 0.2", of_joint=True),
}
