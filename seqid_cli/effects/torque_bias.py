"""A constant offset of the measured torque: the current sensor's zero.

    tau_measured = tau + A

A [N m] is there in every state, at rest too. On a joint whose range is small it is
almost the same as a gravity parameter.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import SINCE_LOG, Coefficient, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import TorqueMeasurement, touched
from seqid_cli.effects.scene import Joint
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class TorqueBias(TorqueMeasurement):
    """A constant."""

    name = "torque_bias"
    drive = True
    slow = True
    change = True
    settings = (SINCE_LOG,)
    exact = True
    over = "session_time"
    linear = (Coefficient("offset", "N m"),)
    alike = ("asymmetric_friction", "spring", "drift", "base_tilt")
    separate_by = (
        "ten seconds with the brakes on or the motors without current, before and"
        " after, and a slow sweep over the joint's whole range"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return a constant."""
        return dict.fromkeys(touched(robot, joint), Law(terms=("1.0",)))

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Subtract the offset."""
        return tau - float(c[0])
