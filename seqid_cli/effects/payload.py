"""A body at the flange that the parameters do not know of.

    tau = Y_n(q, dq, ddq) phi

Y_n are the columns of the last link in the regressor of Eq. 3, phi = (m, mx, my, mz,
Ixx, Ixy, Iyy, Ixz, Iyz, Izz) the ten inertial parameters of what was added [kg, kg m,
kg m^2], in the frame of the last joint, inertia about its origin. It is told only where
a body has them, within their standard errors: one with a mass, whose centre is within
the arm's reach, and whose inertia is that of a body. Or a body has them with the
opposite sign: a tool that was taken off. That is told only where the last link still is
a body without it, by the inertials of the URDF and the payloads that the file has. Base
parameters alone do not say what mass the last link carries: without either a file that
holds a tool which is gone has to be identified anew. A payload that is in all logs
cannot be told from the last link once the latter is free. Compare Khalil, Gautier,
Lemoine, "Identification of the payload inertial parameters of industrial manipulators",
ICRA 2007.
"""

import contextlib

import numpy as np

from seqid_cli.effects.declared import BodyTerm
from seqid_cli.effects.effect import (
    SINCE_LOG,
    Coefficient,
    Columns,
    Effect,
    Settings,
)
from seqid_cli.effects.scene import Joint, Scene, Scenes
from seqid_cli.errors import QualityError
from seqid_cli.model.bodies.consistent import nearest_body
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.robot.regressor import PER_LINK, torque_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# 95 % of estimates of ten coefficients are less far from their truth, in errors.
MOST_ERRORS = 4.3
NEGLIGIBLE = 0.01  # of what the coefficients explain, by errors of other laws
LEAST_VARIANCE = 1e-12  # of the largest, of what is known without error
LEAST_REACH_M = 1.0


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
    alike = ("base_tilt", "torque_constant", "joint_zero", "spring")
    separate_by = (
        "the same motion with and without the payload, and poses that turn the last"
        " link against gravity; move each joint to its zero mark and look, and hold a"
        " known mass for the torque constants"
    )

    def can_exist(self, scenes: Scenes, c: Array, covariance: Array) -> bool:
        """Return whether the nearest body tells about as much as the coefficients do.

        It may lie so many standard errors away, or take away so little of what the
        coefficients explain, that no other effect of the same form would be told apart:
        the torque of no arm is exactly its model's. What is taken off the last link
        must be a body as well, and leave one there.
        """
        variances, directions = np.linalg.eigh(covariance)
        least = LEAST_VARIANCE * max(float(variances.max()), 1e-300)
        whitening = (directions / np.sqrt(np.maximum(variances, least))).T
        explained = float(np.sum((whitening @ c) ** 2))
        allowed = max(MOST_ERRORS**2, NEGLIGIBLE * explained)

        reach = _reach(scenes[0].robot)

        def is_body(phi: Array) -> bool:
            # Where the solver finds nothing, nothing is known against the body.
            with contextlib.suppress(QualityError):
                _, distance = nearest_body(phi, whitening, reach=reach)
                return bool(distance**2 <= allowed)
            return True

        if is_body(c):
            return True
        last_link = scenes[0].last_link
        return last_link is not None and is_body(-c) and is_body(last_link + c)

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


def _reach(robot: Robot) -> float:
    """Return how far from the last joint a body's centre can be, m: an arm's length."""
    length = float(np.sum(np.linalg.norm(robot.chain.position, axis=1)))
    return max(length, LEAST_REACH_M)
