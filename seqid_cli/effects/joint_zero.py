"""The zero of a joint is not where the log has it: the link stands at another angle.

    q_j = q_log + d
    tau_effect = tau_rigid(q_log + d) - tau_rigid(q_log)

d [rad] is the error of the zero. It turns gravity, and inertia, on this joint, on those
before it that carry its link, and on those after it. To first order in d the torque is
(d tau_rigid / d q_j) d; the setting `around` (d_0) makes the column exact near d = d_0:

    X = (tau_rigid(q_log + d_0) - tau_rigid(q_log)) / d_0.

It comes between sessions: by a new motor or belt, or by a calibration at another place.
One that was there when the model was identified is partly in the first moments of the
links, which turn with it. Friction that varies over the position is left where it was.
Hollerbach, Khalil, Gautier, "Model identification", in Springer Handbook of Robotics,
2nd ed., 2016.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.effects.base_tilt import first_joint_upright
from seqid_cli.effects.declared import Shift
from seqid_cli.effects.effect import (
    SINCE_LOG,
    AnyJoint,
    Coefficient,
    Columns,
    Setting,
    Settings,
)
from seqid_cli.effects.measurement import MeasurementEffect
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LARGEST_RAD = 3.2
# Below it the derivative is exact enough.
SMALL_RAD = 1e-3
# Ratio of d to d_0 beyond which the column does not belong to the coefficient. Sines
# hold to this at half a radian.
CONSISTENT = 1.5
FIVE_ANGLES = 2.0 * np.pi / 5.0 * np.arange(5)


class JointZero(MeasurementEffect):
    """Rigid torque at a shifted angle of one joint, minus that at the logged one."""

    name = "joint_zero"
    change = True
    exact = True
    passes = 1
    first_order = True
    settings = (
        Setting(
            "around",
            "rad",
            low=-LARGEST_RAD,
            high=LARGEST_RAD,
            continuous=False,
            grid=(0.0, -0.5, 0.5, -1.5, 1.5),
            agreement=CONSISTENT,
        ),
        SINCE_LOG,
    )
    linear = (Coefficient("zero_error", "rad", low=-LARGEST_RAD, high=LARGEST_RAD),)
    alike = (
        "payload",
        "base_tilt",
        "torque_constant",
        "encoder_eccentricity",
        "spring",
    )
    separate_by = (
        "slow sweeps of the joints before and after this one, this one held in several"
        " postures: a wrong zero turns with this joint alone; or move it to its zero"
        " mark and look"
    )

    def available(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether the rigid body is known, and the joint's angle matters."""
        robot = scenes[0].robot
        around_gravity = joint == 0 and first_joint_upright(robot)
        gravity_acts = bool(robot.gravity.any()) and not around_gravity
        knows_body = all(scene.model.phi is not None for scene in scenes)
        return knows_body and gravity_acts

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Shift:
        """Return between which angles the torque is differentiated."""
        around = settings["around"]
        if abs(around) < SMALL_RAD:
            return Shift(-0.5 * SMALL_RAD, 0.5 * SMALL_RAD)
        return Shift(0.0, around)

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Compute the change of the rigid torque of all joints per rad."""
        shift = self.deviation(scene.robot, joint, settings)
        torque = _change(scene, joint, shift) / (shift.high - shift.low)
        return {j: torque[:, j : j + 1] for j in range(scene.robot.n)}

    def restored(
        self,
        recording: Recording,
        robot: Robot,
        joint: int,
        settings: Settings,
        c: Array,
    ) -> Recording:
        """Add the error of the zero to the logged angle."""
        q = recording.q.copy()
        q[:, joint] += float(c[0])
        return replace(recording, q=q)


def _change(scene: Scene, joint: int, shift: Shift) -> Array:
    """Return the change (N, n) N m of the rigid torque between two angles of a joint.

    A joint's rotation stands twice in the kinetic energy, so that the torque is a sum
    of waves of up to two per turn. Five angles tell these, for all others.
    """
    if scene.robot.joints[joint].prismatic:
        return _at(scene, joint, shift.high) - _at(scene, joint, shift.low)

    key = ("rigid torque at five angles", joint)
    if key not in scene.memo:
        at_angles = [_at(scene, joint, float(angle)) for angle in FIVE_ANGLES]
        scene.memo[key] = (np.stack(at_angles).astype(np.float32),)
    weights = _weights_at(shift.high) - _weights_at(shift.low)
    return np.asarray(np.tensordot(weights, scene.memo[key][0], axes=1))


def _weights_at(angle: float) -> Array:
    """Return by how much a torque at each of the five angles counts at another one."""
    apart = angle - FIVE_ANGLES
    waves = 1.0 + 2.0 * np.cos(apart) + 2.0 * np.cos(2.0 * apart)
    return np.asarray(waves / len(FIVE_ANGLES))


def _at(scene: Scene, joint: int, angle: float) -> Array:
    """Return the rigid torque (N, n) N m with one joint turned by an angle [rad]."""
    if angle == 0.0:
        return scene.rigid
    motion = scene.motion
    q = motion.q.copy()
    q[:, joint] += angle
    return scene.model.rigid(q, motion.dq, motion.ddq)
