"""A joint's true torque per ampere, or its drive's gain, is not the robot file's.

    tau_measured = (1 + e) tau

e [-] is how much too large the nominal torque constant is. A factor that all joints
share is invisible: it scales every inertial parameter. Gautier, Briot, "New method for
global identification of the joint drive gains of robots using a known payload mass",
IROS 2011.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import SINCE_LOG, Coefficient, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import ModelledTorque, touched
from seqid_cli.effects.scene import Joint
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class TorqueConstant(ModelledTorque):
    """Torque in proportion to the modelled one."""

    name = "torque_constant"
    drive = True
    change = True
    settings = (SINCE_LOG,)
    exact = True
    linear = (Coefficient("relative_error", "1", low=-0.9, high=9.0),)
    alike = (
        "payload",
        "joint_zero",
        "torque_saturation",
        "load_dependent_friction",
    )
    separate_by = (
        "the same motion with and without a payload of known mass, as far out as the"
        " arm reaches: the known mass fixes the absolute gain of each joint that"
        " carries it"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return the modelled torque."""
        return dict.fromkeys(touched(robot, joint), Law(terms=("tau",)))

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Divide by 1 + e, which is held above zero."""
        return tau / max(1.0 + float(c[0]), 1e-3)
