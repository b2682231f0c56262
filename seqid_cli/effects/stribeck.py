"""Stribeck friction: more friction at low speed than Coulomb and viscous friction say.

    tau = F_s exp(-(|v| / v_s)^delta) s(v)

F_s [N m] is what is added at the slowest speeds, v_s [rad/s] the Stribeck speed, delta
[-] its exponent (0.5 to 1 after Bo and Pavelescu, 2 for a Gaussian hump).
Armstrong-Helouvry, Dupont, Canudas de Wit, "A survey of models, analysis tools and
compensation methods for the control of machines with friction", Automatica 30(7), 1994.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    FrictionEffect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Scenes, top_speed
from seqid_cli.model.friction import SLIDES
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

ABOVE = 1.5  # times the speed from which samples count
EXPONENTS = (0.5, 1.0, 2.0)
SPEEDS = 7
# Of the top speed.
SLOWEST_SHARE = 0.02
FASTEST_SHARE = 0.5


class Stribeck(FrictionEffect):
    """A hump of friction at low speed."""

    name = "stribeck"
    settings = (
        Setting("stribeck_speed", "rad/s", low=1e-6, high=100.0, logarithmic=True),
        Setting("exponent", "1", low=0.5, high=2.0, continuous=False),
    )
    over = "speed"
    sided = True
    steady = True
    linear = (Coefficient("stribeck_torque", "N m", low=0.0),)
    alike = ("presliding_hysteresis", "quadratic_drag", "nonlinear_viscous")
    separate_by = (
        "constant speeds, both ways, from a third of the Stribeck speed up to the"
        " joint's limit, at least two of them per doubling; then slow reversals at two"
        " accelerations, where speeding up and slowing down must give the same torque"
        " at the same speed"
    )

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return speeds by ratios of about two, and exponents."""
        top = top_speed(scenes, joint)
        slow = min(SLIDES * float(scenes[0].sign_width[joint]), SLOWEST_SHARE * top)
        speeds = np.clip(np.geomspace(slow, FASTEST_SHARE * top, SPEEDS), 1e-6, 100.0)
        return {"stribeck_speed": speeds.tolist(), "exponent": EXPONENTS}

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the hump times the direction."""
        term = "exp(-((abs(dq) / stribeck_speed) ** exponent)) * sign(dq)"
        return {joint: Law(terms=(term,), numbers=settings)}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether the hump is of more friction, and within the logs' speeds.

        It must show mostly at speeds at which the joint certainly slides. Of a narrower
        one the logs show little more than what the low-pass brings over from reversals,
        where nothing is known.
        """
        speed = settings["stribeck_speed"]
        slowest = ABOVE * SLIDES * float(scenes[0].sign_width[joint])
        within = slowest <= speed < top_speed(scenes, joint)
        return within and super().plausible(scenes, joint, settings, c)
