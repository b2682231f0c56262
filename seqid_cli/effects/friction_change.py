"""Friction that is no longer what the file says: wear, new grease, a tighter bearing.

    tau = dF_c s(v) + dF_v v

dF_c [N m] and dF_v [N m s/rad] are what Coulomb and viscous friction have gained since
the friction stage was recorded. Where friction is identified anew with everything else
the change is in it, so this shows against the earlier parameters only. Bittencourt,
Axelsson, "Modeling and experiment design for identification of wear in a robot joint
under load and temperature uncertainties based on friction data", IEEE/ASME Trans.
Mechatronics 19(5), 2014.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import (
    SINCE_LOG,
    Coefficient,
    FrictionEffect,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scenes
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class FrictionChange(FrictionEffect):
    """A constant change of Coulomb and viscous friction."""

    name = "friction_change"
    change = True
    settings = (SINCE_LOG,)
    sided = True
    over = "speed"
    linear = (
        Coefficient("coulomb_change", "N m"),
        Coefficient("viscous_change", "N m s/rad"),
    )
    alike = (
        "thermal_friction",
        "load_dependent_friction",
        "nonlinear_viscous",
        "torque_constant",
    )
    by_motion = False
    separate_by = (
        "the recordings of the friction stage again, at the temperature of the first"
        " time: at once after a cold start and once after ten minutes of motion"
    )

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Return whether the joint moves and its friction was identified before."""
        identified = joint is None or all(
            scene.model.surfaces[joint] is not None for scene in scenes
        )
        return identified and super().available(scenes, joint)

    def searched(self, settings: Settings) -> int:
        """Return 1: the time of the change, which no channel tells.

        Laws with a cause do without it.
        """
        return 1

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return direction and velocity."""
        return {joint: Law(terms=("sign(dq)", "dq"))}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether friction with its change takes energy from the motion."""
        energy = 0.0
        for scene in scenes:
            change = self.columns_in_log(scene, joint, settings)[joint] @ c
            torque = scene.friction[:, joint] + change
            energy += float(torque @ scene.motion.dq[:, joint]) / scene.motion.rate_hz
        return energy >= 0.0
