"""Entries of the robot file by which a user declares what no log shows: their only place here."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Tolerance:
    """An entry that declares one kind of imperfection, with one standard deviation of its sizes.

    `of_joint` says that it stands in every joint's table, `read` that the package knows it.
    """

    entry: str
    of_joint: bool = False
    read: bool = False


TOLERANCES: Mapping[str, Tolerance] = {
    "constant": Tolerance("torque_constant_error = 0.04", of_joint=True, read=True),
    "geometry": Tolerance("geometry_error = { position_m = 0.003, angle_deg = 0.6 }"),
    "gravity": Tolerance("gravity_error = { angle_deg = 1.2 }"),
    "zero": Tolerance("position_zero_error = 0.2", of_joint=True),
}
DECLARABLE = [kind for kind, tolerance in TOLERANCES.items() if tolerance.read]
