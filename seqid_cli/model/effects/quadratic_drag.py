"""Drag that grows with the square of the speed: churning grease, windage.

    tau = c v |v|

c [N m s^2/rad^2] is the drag coefficient. Kermani, Patel, Moallem, "Friction identification and
compensation in robotic manipulators", IEEE Trans. Instrum. Meas. 56(6), 2007.
"""

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, FrictionLaw, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array


class QuadraticDrag(FrictionLaw):
    """Friction with the square of the speed."""

    name = "quadratic_drag"
    over = "speed"
    sided = steady = True
    linear = (Coefficient("drag_coefficient", "N m s^2/rad^2", low=0.0),)
    alike = ("nonlinear_viscous", "stribeck", "thermal_friction")
    separate_by = (
        "a ladder of six constant speeds up and down again, both ways, from a tenth of the speed "
        "limit to the limit; repeated after ten minutes of motion"
    )

    def law(self, scene: Scene, joint: int, settings: Settings) -> Array:
        """Speed times velocity."""
        v = scene.motion.dq[:, joint]
        return (v * np.abs(v))[:, None]
