"""Friction that is larger in one direction than in the other.

    tau = A |s(v)| f(q) + B |v|

A [N m] is half the difference of Coulomb friction between the directions, B [N m s/rad] that of
viscous friction. f is Coulomb friction at the place over its mean, where friction trials have told
it, else 1: without it a share of what friction has over the position looks like a spring. At rest A
is gone, unlike an offset of the torque channel. A model with a free offset per joint holds A
already, but for the dips at reversals. Wang et al., "A convex optimization-based dynamic model
identification package for the da Vinci Research Kit", IEEE RA-L 4(4), 2019; Bona, Indri, "Friction
compensation in robotics: an overview", CDC 2005.
"""

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, FrictionLaw, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array

PLACES = 65  # over which the mean is taken


class AsymmetricFriction(FrictionLaw):
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
        "10 s with the brakes on or the motors off before and after (an offset of the channel "
        "stays, this does not), then constant speeds both ways over the whole position range, at "
        "three speeds"
    )

    def law(self, scene: Scene, joint: int, settings: Settings) -> Array:
        """Whether the joint moves, by Coulomb friction at the place, and its speed."""
        moving, speed = np.abs(scene.sign[:, joint]), np.abs(scene.motion.dq[:, joint])
        return np.stack([moving * _over_position(scene, joint), speed], axis=1)


def _over_position(scene: Scene, joint: int) -> Array:
    """Coulomb friction (N,) at the place of every sample over its mean; 1 where none is told."""
    surface, q = scene.model.surfaces[joint], scene.motion.q[:, joint]
    if surface is None or len(surface.speeds) == 0:
        return np.ones_like(q)
    low, high = surface.scaling.position

    def level(places: Array) -> Array:
        slow = np.full_like(places, surface.scaling.speed[0])
        return np.asarray(surface.torque(places, slow) - surface.torque(places, -slow))

    mean = float(np.mean(level(np.linspace(low, high, PLACES))))
    return level(np.clip(q, low, high)) / mean if mean > 0.0 else np.ones_like(q)
