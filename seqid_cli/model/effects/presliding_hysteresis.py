"""Presliding hysteresis: friction builds up over a distance after a reversal, not at once.

    tau = F_p (x - s(v)),   x' = (v - |v| x) / z_max,   x = z / z_max

z is the bristles' deflection in Dahl's model (LuGre's with constant breakaway), z_max [rad] the
distance over which it settles, F_p [N m] the part of Coulomb friction that is passed on by them;
the step s(v) of the base model is taken off. x depends on the way, not on the speed. While the
joint moves one way by dq it is, in closed form,

    x <- d + (x - d) exp(-|dq| / z_max),   d = sign(dq),

and at rest it stays, so that a stuck joint holds what it was left with. Dahl, "A solid friction
model", Aerospace Corp. TOR-0158, 1968; Canudas de Wit, Olsson, Astrom, Lischinsky, "A new model for
control of systems with friction", IEEE Trans. Autom. Control 40(3), 1995.
"""

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, FrictionLaw, GridAxes, Setting, Settings
from seqid_cli.model.effects.scene import Scene, Scenes, travel
from seqid_cli.typing import Array

DISTANCES = 11
SHORTEST, LONGEST = 1e-4, 0.2  # of the joint's travel, at most of 1 rad
NOTHING = 1e-30  # share of the past that is forgotten; keeps products out of the denormals


class PreslidingHysteresis(FrictionLaw):
    """Bristle deflection after reversals."""

    name = "presliding_hysteresis"
    settings = (Setting("presliding_distance", "rad", low=1e-7, high=0.5, logarithmic=True),)
    linear = (Coefficient("presliding_torque", "N m", low=0.0),)
    alike = ("stribeck", "joint_elasticity", "backlash", "actuator_lag")
    separate_by = (
        "small triangles of half to five presliding distances at three accelerations, at two "
        "postures: the distance over which the torque builds up keeps its size in position, "
        "whatever the acceleration"
    )

    def local(self, settings: Settings) -> bool:
        """No: the deflection remembers the last reversals, however long ago."""
        return False

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Distances from a ten-thousandth to a fifth of the way, by ratios of about two."""
        scale = min(travel(scenes, joint), 1.0)
        distances = np.maximum(np.geomspace(SHORTEST, LONGEST, DISTANCES) * scale, 1e-7)
        return {"presliding_distance": [float(x) for x in distances]}

    def law(self, scene: Scene, joint: int, settings: Settings) -> Array:
        """Deflection less the step that the base model has."""
        x = deflection(scene.motion.q[:, joint], settings["presliding_distance"])
        return (x - scene.sign[:, joint])[:, None]

    def plausible(self, scenes: Scenes, joint: int, settings: Settings, c: Array) -> bool:
        """Ask for friction that settles within the way: else it would be a spring."""
        settles = settings["presliding_distance"] < 0.5 * travel(scenes, joint)
        return settles and super().plausible(scenes, joint, settings, c)


def deflection(q: Array, distance: float) -> Array:
    """Deflection (N,) of Dahl's bristles as a share of their largest: within +-1, from 0 on.

    Each sample maps the deflection before it affinely, x <- keep x + gain. Maps are composed by
    doubling, in log2(N) sweeps over all samples, so there is no loop over time. Positions q (N,)
    [rad] are taken as monotonic between samples; `distance` is z_max [rad].
    """
    way = np.diff(q, prepend=q[:1]) / distance
    keep = np.exp(-np.abs(way))
    gain = -np.sign(way) * np.expm1(-np.abs(way))
    shift = 1
    while shift < len(q):
        gain[shift:] += keep[shift:] * gain[:-shift]
        keep[shift:] = keep[shift:] * keep[:-shift]
        keep[keep < NOTHING] = 0.0
        if not keep[shift:].any():
            break
        shift *= 2
    return np.asarray(np.clip(gain, -1.0, 1.0))  # rounding
