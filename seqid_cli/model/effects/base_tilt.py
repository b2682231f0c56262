"""The base does not stand as the robot file says: gravity comes from another direction.

    tau = G(q; t x g) = t_1 G(q; e_1 x g) + t_2 G(q; e_2 x g)

g [m/s^2] is gravity in the base frame, G(q; .) the gravity torque of the model, linear in it, and
t [rad] a small rotation of gravity about two axes e_1, e_2 square to it: x and y of the base where
it stands upright. A constant tilt hides in the first moments once these are free, to which gravity
torque is as linear: Gautier, Khalil, "Direct calculation of minimum set of inertial parameters of
serial robots", IEEE Trans. Robotics and Automation 6(3), 1990.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Settings
from seqid_cli.model.effects.scene import Scene
from seqid_cli.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]

LARGEST_RAD = 0.35


class BaseTilt(Effect):
    """Gravity turned about two axes square to it."""

    name = "base_tilt"
    family = "body"
    arm = True
    passes = 1
    change = True
    alike = ("payload", "spring", "torque_bias")
    separate_by = (
        "an accelerometer on the base, or fast moves of the proximal joints: inertial torque does "
        "not turn with gravity"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the two rotations."""
        return tuple(
            Coefficient(f"tilt_{k}", "rad", low=-LARGEST_RAD, high=LARGEST_RAD) for k in (1, 2)
        )

    def available(self, scenes: Sequence[Scene], joint: int | None) -> bool:
        """Gravity parameters are needed."""
        return scenes[0].model.phi is not None and bool(scenes[0].robot.gravity.any())

    def columns(self, scene: Scene, joint: int | None, settings: Settings) -> Columns:
        """Gravity torque of two directions square to gravity."""
        q, phi = scene.motion.q, scene.model.phi
        if phi is None:
            return {j: np.zeros((scene.samples, 2)) for j in range(scene.robot.n)}
        still = np.zeros_like(q)
        turned = [
            inverse_dynamics(
                scene.robot.chain, np.cross(axis, scene.robot.gravity), phi, q, still, still
            )
            for axis in tilt_axes(scene.robot.gravity)
        ]
        stacked = np.stack(turned, axis=2)
        return {j: np.ascontiguousarray(stacked[:, j]) for j in range(scene.robot.n)}


def tilt_axes(gravity: Array) -> tuple[Array, Array]:
    """Two unit axes (3,) square to gravity and to each other: x and y where gravity is along z."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    along = gravity / size
    start = np.eye(3)[0 if abs(along[0]) < 0.9 else 1]
    first = start - (start @ along) * along
    first /= np.linalg.norm(first)
    up = -along
    return first, np.cross(up, first)
