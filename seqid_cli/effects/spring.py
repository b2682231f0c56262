"""A spring, counterbalance or cable that acts on a joint beside gravity.

    tau = k (q - q0) + k2 q^2 + k3 q^3

k [N m/rad], q0 [rad] where it is slack, k2 [N m/rad^2] and k3 [N m/rad^3] (0 unless
`cubic`): a cable or hose stiffens, and a spring between two points pulls with another
arm on either side. Where it rubs it follows with hysteresis, which
presliding_hysteresis shows as well. A motor holds against a spring that pulls back with
tau > 0 ahead of q0, so k > 0; a counterbalance that helps away from its dead centre has
k < 0. With the cubic law q0 is where the linear part vanishes. For compensators see
Klimchik et al., "Identification of geometrical and elastostatic parameters of heavy
industrial robots", ICRA 2013.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.effects.effect import Coefficient, Effect, Setting, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Scenes
from seqid_cli.effects.units import Value
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# rad, from the middle of the travel: a joint has been wound up by no more
FURTHEST_REST_RAD = 2.0 * np.pi


class Spring(Effect):
    """Conservative torque of one joint's own position."""

    name = "spring"
    family = "transmission"
    settings = (
        Setting("cubic", "1", low=0.0, high=1.0, continuous=False, grid=(0.0, 1.0)),
    )
    passes = 1
    later = ("quadratic_stiffness",)
    over = "position"
    alike = ("torque_bias", "payload", "base_tilt", "presliding_hysteresis")
    separate_by = (
        "slow sweeps of this joint over its whole range, both ways, with the other"
        " joints in two poses that turn gravity on it round: a spring does not follow"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return stiffness, torque at q = 0 and, if `cubic`, the two further ones."""
        linear = (
            Coefficient("stiffness", "N m/rad"),
            Coefficient("torque_at_zero", "N m"),
        )
        if settings["cubic"] > 0.5:
            squared = Coefficient("quadratic_stiffness", "N m/rad^2")
            return (*linear, Coefficient("cubic_stiffness", "N m/rad^3"), squared)
        return linear

    def simpler(self, settings: Settings) -> dict[str, float] | None:
        """Return the linear law in place of the cubic one."""
        return {**settings, "cubic": 0.0} if settings["cubic"] > 0.5 else None

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the position, a constant and, if `cubic`, its cube and square."""
        terms: tuple[str, ...] = ("q", "1.0")
        if settings["cubic"] > 0.5:
            terms += ("q * q * q", "q * q")
        return {joint: Law(terms=terms)}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether a part could be slack, or dead, where the law says it is.

        The torque of a spring that rests many turns away is the same all over the
        travel: that is an offset. Of a cubic law the rest position is no such place.
        """
        is_cubic = settings["cubic"] > 0.5
        if is_cubic or scenes[0].robot.joints[joint].prismatic:
            return super().plausible(scenes, joint, settings, c)
        lowest = min(float(np.min(scene.motion.q[:, joint])) for scene in scenes)
        highest = max(float(np.max(scene.motion.q[:, joint])) for scene in scenes)
        torque_at_middle = abs(c[0] * 0.5 * (lowest + highest) + c[1])
        rests_near = bool(torque_at_middle <= FURTHEST_REST_RAD * abs(c[0]))
        return rests_near and super().plausible(scenes, joint, settings, c)

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return stiffness, rest position -c_1 / c_0 (delta method), and the others."""
        values = super().values(robot, joint, settings, c, covariance)
        if c[0] == 0.0:
            return values

        slope = np.zeros(len(c))
        slope[0] = c[1] / c[0] ** 2
        slope[1] = -1.0 / c[0]
        variance = float(slope @ covariance @ slope)
        error = float(np.sqrt(max(variance, 0.0)))
        unit = robot.joints[joint].unit("rad")
        values[1] = Value("rest_position", float(-c[1] / c[0]), error, unit)
        return values
