"""Friction and cables that remember: bristles (Dahl, LuGre) and Maxwell slip."""

from dataclasses import dataclass

import numpy as np

from tests import Array
from tests.plants.friction.surface import Friction, FrictionModel, Law


@dataclass(frozen=True)
class Bristles:
    """Replaces the dry friction of one joint by bristles that bend before they slip.

    z' = v - |v| z / z_ss with z_ss = level(v)/stiffness, torque = stiffness z + damping z' + the
    smooth part; level is the dry level of `base` in the direction of motion, so that the torque
    at constant speed is that of `base`. `stiffness` N m/rad, `damping` N m s/rad, at the joint.
    """

    base: FrictionModel
    joint: int
    stiffness: float
    damping: float = 0.0

    def begin(self) -> Law:
        """Return the law of one run, from unbent bristles."""
        base, i = self.base.begin(), self.joint
        bend, before = 0.0, np.nan

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            nonlocal bend, before
            forward, backward, smooth = (x.copy() for x in base(t, q, dq, load))
            here, rate = float(q[i]), float(dq[i])
            way = 0.0 if np.isnan(before) else here - before
            before = here
            limit = max(float(forward[i] if way >= 0 else backward[i]), 1e-12) / self.stiffness
            bend = slip(bend, way, limit)
            bending = rate - abs(rate) * bend / limit
            smooth[i] += self.stiffness * bend + self.damping * bending
            forward[i] = backward[i] = 0.0
            return Friction(forward, backward, smooth)

        return law


def slip(bend: float, way: float, limit: float) -> float:
    """Bend of the bristles after a move of `way` rad, exact for any length of it, rad."""
    goal = limit if way >= 0 else -limit
    return float(goal + (bend - goal) * np.exp(-abs(way) / limit))
