"""A body at the flange that the parameters do not know of: added, removed or changed.

    tau = Y_n(q, dq, ddq) phi

Y_n are the columns of the last link in the regressor of Eq. 3, phi = (m, mx, my, mz,
Ixx, Ixy, Iyy, Ixz, Iyz, Izz) the ten inertial parameters of what was added [kg, kg m,
kg m^2], in the frame of the last joint, inertia about its origin. A payload that is in
all logs cannot be told from the last link once the latter is free. Compare Khalil,
Gautier, Lemoine, "Identification of the payload inertial parameters of industrial
manipulators", ICRA 2007.
"""

import numpy as np

from seqid_cli.effects.declared import BodyTerm
from seqid_cli.effects.effect import (
    SINCE_LOG,
    Coefficient,
    Columns,
    Effect,
    Settings,
)
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.robot.regressor import PER_LINK, torque_regressor
from seqid_cli.robot.types import Robot


class Payload(Effect):
    """Ten inertial parameters added to the last link."""

    name = "payload"
    family = "body"
    arm = True
    change = True
    exact = True
    settings = (SINCE_LOG,)
    passes = 1
    linear = tuple(
        Coefficient(f"payload_{kind}", parameter_unit(f"{kind}_1")) for kind in STANDARD
    )
    alike = ("base_tilt", "torque_constant", "spring")
    separate_by = (
        "the same motion with and without the payload, and poses that turn the last"
        " link against gravity"
    )

    def body_terms(
        self, robot: Robot, joint: Joint, settings: Settings
    ) -> list[BodyTerm]:
        """Return the last link's parameters one by one, from `from_log` on."""
        return [BodyTerm(last_link=unit) for unit in np.eye(PER_LINK)]

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Return the last link's columns of the regressor, for every joint."""
        motion = scene.motion
        n = scene.robot.n
        of_last_link = list(range(PER_LINK * (n - 1), PER_LINK * n))
        Y = torque_regressor(
            scene.robot.chain,
            scene.robot.gravity,
            motion.q,
            motion.dq,
            motion.ddq,
            columns=of_last_link,
        )
        return {j: np.ascontiguousarray(Y[:, j]) for j in range(n)}
