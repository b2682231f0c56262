"""The log holds the commanded torque, and the drive follows it with a lag.

    T dtau/dt + tau = tau_command,      so that      tau_logged = tau + T dtau/dt

exactly, T [s] being the drive's time constant. To first order the same as torque logged
early by T. Khalil, Dombre, "Modeling, identification and control of robots", 2002.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, Columns, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import ModelledTorque, steady_change, touched
from seqid_cli.effects.memory import Rate, lagged
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class ActuatorLag(ModelledTorque):
    """Command minus torque of a first-order drive.

    Of one joint, or one lag of all joints (joint None).
    """

    name = "actuator_lag"
    timing = True
    steady = True
    even = True
    shared = True
    linear = (Coefficient("time_constant", "s", low=0.0, high=0.2),)
    alike = ("time_skew", "joint_elasticity")
    separate_by = (
        "log the measured current beside the commanded one; or chirps of torque up to"
        " the frequency 1/(2 pi T), where a lag attenuates and a delay does not"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return the time derivative of the modelled torque."""
        law = Law(terms=("tau_rate",), memories={"tau_rate": Rate("tau")})
        return dict.fromkeys(touched(robot, joint), law)

    def steady_columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Compute the derivative from the torque a little later on the way."""
        return steady_change(scene, joint)

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Send the command through the lag, starting settled."""
        time_constant = float(c[0])
        if time_constant <= 0.0 or not len(tau):
            return tau.copy()

        return lagged(tau, time_constant, rate_hz)
