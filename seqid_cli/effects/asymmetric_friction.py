"""Friction that is larger in one direction than in the other.

    tau = A |s(v)| f(q) + B |v|

A [N m] is half the difference of Coulomb friction between the directions, B [N m s/rad]
that of viscous friction. f is Coulomb friction at the place over its mean, where
friction trials have told it, else 1: without it a share of what friction has over the
position looks like a spring. At rest A is gone, unlike an offset of the torque channel.
A model with a free offset per joint holds A already, but for the dips at reversals.
Wang et al., "A convex optimization-based dynamic model identification package for the
da Vinci Research Kit", IEEE RA-L 4(4), 2019; Bona, Indri, "Friction compensation in
robotics: an overview", CDC 2005.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, FrictionEffect, Settings
from seqid_cli.effects.law import Law
from seqid_cli.robot.types import Robot


class AsymmetricFriction(FrictionEffect):
    """Coulomb and viscous friction that depend on the direction of motion."""

    name = "asymmetric_friction"
    over = "velocity"
    share_of = "position_dependent_friction"
    linear = (
        Coefficient("coulomb_asymmetry", "N m"),
        Coefficient("viscous_asymmetry", "N m s/rad"),
    )
    alike = ("torque_bias", "spring", "drift", "gear_efficiency")
    separate_by = (
        "10 s with the brakes on or the motors off before and after (an offset of the"
        " channel stays, this does not), then constant speeds both ways over the whole"
        " position range, at three speeds"
    )

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return a constant where it moves, times Coulomb friction, and the speed."""
        return {joint: Law(terms=("abs(sign(dq)) * coulomb_share", "abs(dq)"))}
