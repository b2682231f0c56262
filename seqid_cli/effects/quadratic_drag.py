"""Drag that grows with the square of the speed: churning grease, windage.

    tau = c v |v|

c [N m s^2/rad^2] is the drag coefficient. Kermani, Patel, Moallem, "Friction
identification and compensation in robotic manipulators", IEEE Trans. Instrum. Meas.
56(6), 2007.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, FrictionEffect, Settings
from seqid_cli.effects.law import Law
from seqid_cli.robot.types import Robot


class QuadraticDrag(FrictionEffect):
    """Friction with the square of the speed."""

    name = "quadratic_drag"
    over = "speed"
    sided = True
    steady = True
    linear = (Coefficient("drag_coefficient", "N m s^2/rad^2", low=0.0),)
    alike = ("nonlinear_viscous", "stribeck", "thermal_friction")
    separate_by = (
        "a ladder of six constant speeds up and down again, both ways, from a tenth of"
        " the speed limit to the limit; repeated after ten minutes of motion"
    )

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return speed times velocity."""
        return {joint: Law(terms=("dq * abs(dq)",))}
