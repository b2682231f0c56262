"""Gear friction that grows with the load: tooth forces press harder, and rub harder.

    tau = k_l |tau_L| s(v)

tau_L [N m] is the torque that the gear passes to the link, without the joint's own
rotor; k_l [-] the share of it that is lost, both when the gear drives and when it is
driven. Where no file knows the inertia of the rotor well, the losses tell it:
`reflected_rotor_inertia`, at the joint. Hamon, Gautier, Garrec, "New dry friction model
with load- and velocity-dependence and dynamic identification of multi-DOF robots", ICRA
2011.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, Settings
from seqid_cli.effects.gear_load import LoadLoss
from seqid_cli.effects.law import Law
from seqid_cli.robot.types import Robot


class LoadDependentFriction(LoadLoss):
    """Friction in proportion to the transmitted torque."""

    name = "load_dependent_friction"
    over = "load_size"
    linear = (Coefficient("load_coefficient", "1", low=0.0, high=0.5),)
    alike = ("gear_efficiency", "torque_saturation")
    separate_by = (
        "the same speed, both ways, at different gravity loads or with two payloads:"
        " lift and lower each"
    )

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the size of the load times the direction."""
        load, numbers = self.load(settings)
        return {joint: Law(terms=(f"abs({load}) * sign(dq)",), numbers=numbers)}
