"""Viscous friction that is not linear in the speed: thinning grease, or a cubic.

    tau = c s(v) (|v| / v_1)^e,   v_1 = 1 rad/s

c [N m] is the torque at 1 rad/s (1 m/s for a slide), e [-] the exponent: below 1 where
grease thins, about 3 where a cubic is needed. e = 1 is viscous friction, e = 2
quadratic drag; neither goes by this name. Waiboer, Aarts, Jonker, "Velocity dependence
of joint friction in robotic manipulators with gear transmissions", ECCOMAS Multibody
Dynamics, 2005; Wolf, Iskandar, "Extending a dynamic friction model with nonlinear
viscous and thermal dependency for a motor and harmonic drive gear", ICRA 2018.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    FrictionEffect,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scenes
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

NAMED_OTHERWISE = ((0.85, 1.15), (1.8, 2.2))  # exponents of other effects


class NonlinearViscous(FrictionEffect):
    """Friction with a power of the speed."""

    name = "nonlinear_viscous"
    settings = (Setting("exponent", "1", low=0.3, high=4.0, grid=(0.5, 3.0)),)
    over = "speed"
    sided = True
    steady = True
    alike = ("quadratic_drag", "stribeck", "thermal_friction")
    separate_by = (
        "a ladder of eight constant speeds up and down again, both ways, from a"
        " fiftieth of the speed limit to the limit; repeated after ten minutes of"
        " motion"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the torque at 1 rad/s; a negative root would be a Stribeck hump."""
        low = 0.0 if settings["exponent"] < 1.0 else -np.inf
        return (Coefficient("viscous_torque", "N m", low=low),)

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return a power of the speed times the direction."""
        return {joint: Law(terms=("abs(dq) ** exponent * sign(dq)",), numbers=settings)}

    def plausible(
        self, scenes: Scenes, joint: Joint, settings: Settings, c: Array
    ) -> bool:
        """Return whether the exponent is not viscous friction's or quadratic drag's."""
        named_otherwise = any(
            low < settings["exponent"] < high for low, high in NAMED_OTHERWISE
        )
        return not named_otherwise and super().plausible(scenes, joint, settings, c)
