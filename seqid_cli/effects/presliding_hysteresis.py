"""Presliding hysteresis: friction builds up over a distance after a reversal.

    tau = F_p (x - s(v)),   x' = (v - |v| x) / z_max,   x = z / z_max

z is the bristles' deflection in Dahl's model (LuGre's with constant breakaway), z_max
[rad] the distance over which it settles, F_p [N m] the part of Coulomb friction that is
passed on by them; the step s(v) of the base model is taken off. x depends on the way,
not on the speed. While the joint moves one way by dq it is, in closed form,

    x <- d + (x - d) exp(-|dq| / z_max),   d = sign(dq),

and at rest it stays, so that a stuck joint holds what it was left with. Dahl, "A solid
friction model", Aerospace Corp. TOR-0158, 1968; Canudas de Wit, Olsson, Astrom,
Lischinsky, "A new model for control of systems with friction", IEEE Trans. Autom.
Control 40(3), 1995.
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
from seqid_cli.effects.memory import Bristles
from seqid_cli.effects.scene import Scenes, travel
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

DISTANCES = 11
# Of the joint's travel, at most of 1 rad.
SHORTEST = 1e-4
LONGEST = 0.2


class PreslidingHysteresis(FrictionEffect):
    """Bristle deflection after reversals."""

    name = "presliding_hysteresis"
    settings = (
        Setting("presliding_distance", "rad", low=1e-7, high=0.5, logarithmic=True),
    )
    linear = (Coefficient("presliding_torque", "N m", low=0.0),)
    alike = ("stribeck", "joint_elasticity", "backlash", "actuator_lag")
    separate_by = (
        "small triangles of half to five presliding distances at three accelerations,"
        " at two postures: the distance over which the torque builds up keeps its size"
        " in position, whatever the acceleration"
    )

    def local(self, settings: Settings) -> bool:
        """Return False: the deflection remembers reversals, however long ago."""
        return False

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return distances up to a fifth of the travel, by ratios of about two."""
        scale = min(travel(scenes, joint), 1.0)
        distances = np.geomspace(SHORTEST, LONGEST, DISTANCES) * scale
        return {"presliding_distance": np.maximum(distances, 1e-7).tolist()}

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the deflection less the step that the base model has."""
        bristles = Bristles(settings["presliding_distance"])
        return {
            joint: Law(terms=("bristle - sign(dq)",), memories={"bristle": bristles})
        }

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether friction settles within the travel: else it is a spring."""
        settles = settings["presliding_distance"] < 0.5 * travel(scenes, joint)
        return settles and super().plausible(scenes, joint, settings, c)
