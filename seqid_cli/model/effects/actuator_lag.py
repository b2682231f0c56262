"""The log holds the commanded torque, and the drive follows it with a lag.

    T dtau/dt + tau = tau_command,      so that      tau_logged = tau + T dtau/dt

exactly, T [s] being the drive's time constant. To first order the same as torque logged
early by T. Khalil, Dombre, "Modeling, identification and control of robots", 2002.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from seqid_cli.model.effects.effect import Coefficient, Columns, Settings
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.measurement import ModelledTorque, steady_change, touched
from seqid_cli.model.effects.memory import Rate
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class ActuatorLag(ModelledTorque):
    """Command minus torque of a first-order drive; of one joint, or one lag of all (joint None)."""

    name = "actuator_lag"
    timing = steady = even = shared = True
    linear = (Coefficient("time_constant", "s", low=0.0, high=0.2),)
    alike = ("time_skew", "joint_elasticity")
    separate_by = (
        "log the measured current beside the commanded one; or chirps of torque up to"
        " the frequency 1/(2 pi T), where a lag attenuates and a delay does not"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Time derivative of the modelled torque."""
        law = Law(terms=("tau_rate",), memories={"tau_rate": Rate("tau")})
        return dict.fromkeys(touched(robot, joint), law)

    def steady_columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """The same from the torque a little later on the way."""
        return steady_change(scene, joint)

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Send the command through the lag, starting settled."""
        lag = float(c[0])
        if lag <= 0.0 or not len(tau):
            return tau.copy()
        # Exact for torque that is linear between the samples.
        past = float(np.exp(-1.0 / (rate_hz * lag)))
        ramp = rate_hz * lag * (1.0 - past)
        b, a, settled = [1.0 - ramp, ramp - past], [1.0, -past], ramp * tau[:1]
        return np.asarray(lfilter(b, a, tau, axis=0, zi=settled)[0])
