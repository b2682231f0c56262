"""A joint's encoder disc sits off centre: its angle wanders once or twice per turn.

    q_measured = q + e_s sin(p) + e_c cos(p),        p = order N q
    tau_effect = -(d tau / d q, dq, ddq) . (e, de/dt, d2e/dt2)

e [rad] at the joint, N the gear ratio (1 where unknown), `order` in cycles per motor
turn: 1 for an eccentric disc, 2 for unequal sine and cosine tracks; per turn of the
joint that is order N. What the model is told it computes from the wrong angle; the
effect is what that costs. Its inertial part grows with the square of the speed. An
eccentricity d of a disc of radius R gives e = d / R on the encoder's shaft: Matsuzoe et
al., "High-performance absolute rotary encoder using multitrack and M-code", Optical
Engineering 42(1), 2003.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.effects.declared import Wave
from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    GridAxes,
    Setting,
    Settings,
    amplitude_and_phase,
)
from seqid_cli.effects.measurement import MeasurementEffect
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.sensitivity import modelled_slopes
from seqid_cli.effects.units import Value
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

ORDERS = (1.0, 2.0)
# Below this gear ratio an order of the joint and one of the motor are the same thing.
FINE_GEAR = 5.0
LARGEST_RAD = 0.05


class EncoderEccentricity(MeasurementEffect):
    """Periodic error of the measured angle, through the whole model."""

    name = "encoder_eccentricity"
    steady = True
    even = True
    settings = (Setting("order", "cycles per motor turn", low=0.0, continuous=False),)
    linear = (
        Coefficient("error_sin", "rad", -LARGEST_RAD, LARGEST_RAD),
        Coefficient("error_cos", "rad", -LARGEST_RAD, LARGEST_RAD),
    )
    alike = ("torque_ripple", "joint_elasticity")
    separate_by = (
        "one slow and one fast pass at constant speed: torque from a wrong angle grows"
        " with the square of the speed, ripple does not"
    )

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return orders 1 and 2 of the motor, and those of the joint if they differ."""
        gear_ratio = abs(float(scenes[0].gear[joint]))
        of_joint = []
        if gear_ratio > FINE_GEAR:
            of_joint = [order / gear_ratio for order in ORDERS]
        return {"order": [*ORDERS, *of_joint]}

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Wave:
        """Return the wave over the angle that the encoder reports."""
        return Wave(settings["order"] * float(gear_ratios(robot)[joint]))

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Return minus the derivative of the modelled torque along the angle's error.

        The error e and its time derivatives are those of sin(p) and cos(p).
        """
        motion = scene.motion
        rate = self.deviation(scene.robot, joint, settings).rate
        p = rate * motion.q[:, joint]
        dp = rate * motion.dq[:, joint]
        ddp = rate * motion.ddq[:, joint]

        sin = np.sin(p)
        cos = np.cos(p)
        errors = [
            [sin, cos * dp, cos * ddp - sin * dp**2],
            [cos, -sin * dp, -sin * ddp - cos * dp**2],
        ]
        # Indices: c coefficient, k derivative, n sample, j joint that feels it.
        torque = -np.einsum("knj,ckn->jnc", modelled_slopes(scene, joint), errors)
        return dict(enumerate(torque))

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return amplitude and phase of the angle's error."""
        unit = robot.joints[joint].unit(self.linear[0].unit)
        return amplitude_and_phase("error", unit, c, covariance)

    def restored(
        self,
        recording: Recording,
        robot: Robot,
        joint: int,
        settings: Settings,
        c: Array,
    ) -> Recording:
        """Take the error off the measured angle."""
        gear_ratio = float(gear_ratios(robot)[joint])
        p = settings["order"] * gear_ratio * recording.q[:, joint]
        q = recording.q.copy()
        q[:, joint] -= c[0] * np.sin(p) + c[1] * np.cos(p)
        return replace(recording, q=q)
