"""Units of joints' quantities: of revolute joints, or of prismatic ones."""

import re

_TORQUE = re.compile(r"\bN m\b(?!\^)")
_ANGLE = re.compile(r"\brad\b")


def unit_of(unit: str, prismatic: bool) -> str:
    """Return the unit of a parameter of a joint, "N s/m" for "N m s/rad" where it is `prismatic`.

    `unit` is as for a revolute joint: "N m" for torque and "rad" for the joint's
    position; an angle that is not the joint's own (a phase, a tilt) must not be given.
    """
    return _ANGLE.sub("m", _TORQUE.sub("N", unit)) if prismatic else unit
