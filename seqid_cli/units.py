"""Units of the quantities of joints, which turn or slide."""

import re

_TORQUE = re.compile(r"\bN m\b(?!\^)")
_ANGLE = re.compile(r"\brad\b")


def unit_of(unit: str, prismatic: bool) -> str:
    """Return the unit of a quantity of a joint: "N s/m" for "N m s/rad" if it slides.

    Parameters
    ----------
    unit : str
        Unit for a revolute joint, with "N m" for torque and "rad" for position. An
        angle that is not the joint's own (a phase, a tilt) must not be given.
    prismatic : bool
        Whether the joint slides.
    """
    if not prismatic:
        return unit
    return _ANGLE.sub("m", _TORQUE.sub("N", unit))
