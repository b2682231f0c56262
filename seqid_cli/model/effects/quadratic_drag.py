"""Drag that grows with the square of the speed: churning grease, windage.

    tau = c v |v|

c [N m s^2/rad^2] is the drag coefficient. Kermani, Patel, Moallem, "Friction identification and
compensation in robotic manipulators", IEEE Trans. Instrum. Meas. 56(6), 2007.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Settings
from seqid_cli.model.effects.excitation import moves
from seqid_cli.model.effects.scene import Scene


class QuadraticDrag(Effect):
    """Friction with the square of the speed."""

    name = "quadratic_drag"
    family = "friction"
    over = "speed"
    sided = True
    alike = ("nonlinear_viscous", "stribeck", "thermal_friction")
    separate_by = (
        "a ladder of six constant speeds up and down again, both ways, from a tenth of the speed "
        "limit to the limit; repeated after ten minutes of motion"
    )

    def available(self, scenes: Sequence[Scene], joint: int | None) -> bool:
        """Ask that the joint moves."""
        return joint is not None and moves(scenes, joint)

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the drag coefficient."""
        return (Coefficient("drag_coefficient", "N m s^2/rad^2", low=0.0),)

    def columns(self, scene: Scene, joint: int | None, settings: Settings) -> Columns:
        """Speed times velocity."""
        assert joint is not None
        v = scene.motion.dq[:, joint]
        return {joint: (v * np.abs(v))[:, None]}
