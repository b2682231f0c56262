"""A motor's rotor is not as heavy as the robot file says, or turns the link that carries it.

    tau_j = dJ N_j^2 ddq_j                                        (coupling 0)
    tau   = J d(rotor torque)/dJ, all of its joints               (coupling 1)

dJ [kg m^2] is the error of the inertia J on the motor side, N the gear ratio. With
coupling 1 the rotor's spin also acts on the link that it rides on, N_j (ddq_j z_j +
dq_j w x z_j), z_j its axis, w that link's angular velocity (rotor_regressor,
"gyroscopic", without the diagonal term). Murphy, Wen, Saridis, "Simulation and analysis
of flexibly jointed manipulators", CDC 1990; Modelica Rotor1D.
"""

import numpy as np

from seqid_cli.model.effects.declared import BodyTerm
from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.model.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class RotorInertia(Effect):
    """Inertia of one motor beyond the file's."""

    name = "rotor_inertia"
    family = "body"
    drive = exact = True
    settings = (Setting("coupling", "1", low=0.0, high=1.0, continuous=False),)
    passes = 1
    over = "acceleration"
    alike = ("payload", "torque_constant")
    separate_by = (
        "fast moves of this joint with the others still, in poses that change the"
        " links' inertia about it: the rotor's does not change"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the inertia: missing (coupling 0) or whole (coupling 1)."""
        if settings["coupling"] > 0.5:
            return (Coefficient("rotor_inertia", "kg m^2", low=0.0),)
        return (Coefficient("rotor_inertia_error", "kg m^2"),)

    def axes(self, scenes: Scenes, joint: Joint) -> GridAxes:
        """The diagonal term, and the coupling where the model lacks it."""
        carried = bool(joint) and not scenes[0].robot.chain.prismatic[joint]
        lacks = carried and scenes[0].model.coupling == "diagonal"
        return {"coupling": [0.0, 1.0] if lacks else [0.0]}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """No rotor is left with a negative inertia; one that no file gives may have been any."""
        known = scenes[0].robot.joints[joint].rotor_inertia
        if settings["coupling"] > 0.5:
            return bool(c[0] >= 0.0)
        return known is None or bool(c[0] >= -known)

    def body_terms(
        self, robot: Robot, joint: int, settings: Settings
    ) -> list[BodyTerm]:
        """Return the armature, or the rotor that turns the link before the joint."""
        gear, own = gear_ratios(robot), np.eye(robot.n)[joint]
        if settings["coupling"] <= 0.5:
            return [BodyTerm(armature=gear**2 * own)]
        return [BodyTerm(rotor=np.where(robot.chain.prismatic, 0.0, gear * own))]

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Acceleration times the square of the gear ratio, or the couplings alone."""
        motion = scene.motion
        if settings["coupling"] <= 0.5:
            return {joint: (scene.gear[joint] ** 2 * motion.ddq[:, joint])[:, None]}
        states = motion.q, motion.dq, motion.ddq
        Y = rotor_regressor(scene.robot.chain, *states, scene.gear, "gyroscopic")
        torque = Y[:, :, joint].copy()
        torque[:, joint] -= scene.gear[joint] ** 2 * motion.ddq[:, joint]
        return {j: torque[:, j : j + 1] for j in range(joint + 1)}
