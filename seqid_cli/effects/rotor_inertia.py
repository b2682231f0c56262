"""A motor's rotor is not as heavy as the file says, or turns the link that carries it.

    tau_j = dJ N_j^2 ddq_j                                        (coupling 0)
    tau   = J d(rotor torque)/dJ, all of its joints               (coupling 1)

dJ [kg m^2] is the error of the inertia J on the motor side, N the gear ratio. With
coupling 1 the rotor's spin also acts on the link that it rides on, N_j (ddq_j z_j +
dq_j w x z_j), z_j its axis, w that link's angular velocity (rotor_regressor,
"gyroscopic", without the diagonal term). Murphy, Wen, Saridis, "Simulation and analysis
of flexibly jointed manipulators", CDC 1990; Modelica Rotor1D.
"""

import numpy as np

from seqid_cli.effects.declared import BodyTerm
from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import rotor_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class RotorInertia(Effect):
    """Inertia of one motor beyond the file's."""

    name = "rotor_inertia"
    family = "body"
    drive = True
    exact = True
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
        """Return the diagonal term, and the coupling where the model lacks it."""
        # A rotor on the base, or of a slide, turns no link that carries it.
        rides_on_link = bool(joint) and not scenes[0].robot.chain.prismatic[joint]
        lacks_coupling = rides_on_link and scenes[0].model.coupling == "diagonal"
        return {"coupling": [0.0, 1.0] if lacks_coupling else [0.0]}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether the rotor's inertia, its error included, is not negative.

        A rotor that the robot file does not give may have any.
        """
        inertia_in_file = scenes[0].robot.joints[joint].rotor_inertia
        if settings["coupling"] > 0.5:
            return bool(c[0] >= 0.0)
        return inertia_in_file is None or bool(c[0] >= -inertia_in_file)

    def body_terms(
        self, robot: Robot, joint: int, settings: Settings
    ) -> list[BodyTerm]:
        """Return the armature, or the rotor that turns the link before the joint."""
        gear_ratio = gear_ratios(robot)
        of_joint = np.eye(robot.n)[joint]
        if settings["coupling"] <= 0.5:
            return [BodyTerm(armature=gear_ratio**2 * of_joint)]
        rotor = np.where(robot.chain.prismatic, 0.0, gear_ratio * of_joint)
        return [BodyTerm(rotor=rotor)]

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Return acceleration times gear ratio squared, or the couplings alone."""
        motion = scene.motion
        diagonal = scene.gear[joint] ** 2 * motion.ddq[:, joint]
        if settings["coupling"] <= 0.5:
            return {joint: diagonal[:, None]}

        Y = rotor_regressor(
            scene.robot.chain,
            motion.q,
            motion.dq,
            motion.ddq,
            scene.gear,
            "gyroscopic",
        )
        torque = Y[:, :, joint].copy()
        torque[:, joint] -= diagonal
        return {j: torque[:, j : j + 1] for j in range(joint + 1)}
