"""Gear efficiency that differs between driving and being driven.

    tau = |tau_L| s(v) [k_d 1(tau_L v > 0) + k_b 1(tau_L v < 0)],   k_d = 1 / eta_d - 1,
                                                                    k_b = 1 - eta_b

tau_L [N m] is the torque that the gear passes to the link, without the joint's own
rotor; eta_d and eta_b [-] the efficiencies while power flows from motor to link
(lifting) and from link to motor (lowering). Equal losses, k_d = k_b, are load-dependent
friction. Where no file knows the inertia of the rotor well, the losses tell it:
`reflected_rotor_inertia`, at the joint. Pennestri, Freudenstein, "The mechanical
efficiency of epicyclic gear trains", J. Mech. Des. 115(3), 1993; Duclusaud et al.,
"Extended friction models for the physics simulation of servo actuators", arXiv
2410.08650, 2024.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, Settings
from seqid_cli.effects.gear_load import LoadLoss
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint
from seqid_cli.effects.units import Value
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class GearEfficiency(LoadLoss):
    """Losses in proportion to the transmitted torque, for each direction of power."""

    name = "gear_efficiency"
    even = True
    over = "driving_load"
    linear = (
        Coefficient("driving_loss", "1", low=0.0, high=1.5),
        Coefficient("backdriving_loss", "1", low=0.0, high=1.0),
    )
    alike = ("load_dependent_friction", "torque_saturation", "asymmetric_friction")
    separate_by = (
        "lift and lower the same load at the same constant speed, then with another"
        " payload: the half-sum of both torques keeps a share of the load only where"
        " the two losses differ"
    )

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return load size times direction, where the gear drives and where driven."""
        load, numbers = self.load(settings)
        # Both parts have the same size. Their signs agree where the gear drives, so
        # that their sum is the loss there and their difference is nothing; where the
        # gear is driven it is the other way round.
        parts = {
            "load_j": load,
            "loss": "0.5 * abs(load_j) * sign(dq)",
            "driven": "0.5 * load_j * abs(sign(dq))",
        }
        terms = ("loss + driven", "loss - driven")
        return {joint: Law(terms=terms, parts=parts, numbers=numbers)}

    def values(
        self,
        robot: Robot,
        joint: Joint,
        settings: Settings,
        c: Array,
        covariance: Array,
    ) -> list[Value]:
        """Return the losses and, behind them, the efficiencies that they stand for."""
        losses = super().values(robot, joint, settings, c, covariance)
        driving, backdriving = losses
        eta_d = 1.0 / max(1.0 + driving.value, 0.1)
        eta_b = 1.0 - backdriving.value
        return [
            *losses,
            Value("driving_efficiency", eta_d, eta_d**2 * driving.std_error, "1"),
            Value("backdriving_efficiency", eta_b, backdriving.std_error, "1"),
        ]
