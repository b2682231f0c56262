"""Keys of the robot file by which a user declares what no log shows: their only place here."""

from collections.abc import Mapping

# Kinds of imperfections, and the entry that declares them: in a joint's table, or of the robot.
OF_JOINT: Mapping[str, str] = {"constant": "torque_constant_error"}
OF_ROBOT: Mapping[str, str] = {}
# Entries that the package does not read yet move up from here once it does.
PLANNED: Mapping[str, str] = {
    "geometry": "geometry_error",
    "gravity": "gravity_error",
    "zero": "position_zero_error",
}
DECLARABLE = (*OF_JOINT, *OF_ROBOT)
INVISIBLE = ("constant", *PLANNED)  # kinds that no log needs to show
