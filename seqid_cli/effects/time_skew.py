"""Torque is logged late or early against the positions.

    tau_logged(t) = tau(t - d)

d [s] is the delay. To first order the logged torque differs by -d dtau/dt; the setting
`around` (d_0) makes the column exact near d = d_0:

    X = (tau(t - d_0) - tau(t)) / d_0.

Friction's steps are shifted with the rest, which is what tells a delay from an elastic
joint. A delay and a lag agree to first order and part in the second, d^2/2 against T^2
times the second derivative.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Coefficient, Columns, Setting, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import (
    SMALL_S,
    ModelledTorque,
    steady_change,
    touched,
)
from seqid_cli.effects.memory import Late, Rate, delayed
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LARGEST_S = 0.1
# Ratio of d to d_0 beyond which the column does not belong to the coefficient. Free
# base parameters take up part of a delay: the residual's own comes out too short.
CONSISTENT = 1.5


class TimeSkew(ModelledTorque):
    """Modelled torque, shifted, minus itself.

    Of one joint, or one delay of all joints (joint None).
    """

    name = "time_skew"
    settings = (
        Setting(
            "around",
            "s",
            low=-LARGEST_S,
            high=LARGEST_S,
            continuous=False,
            grid=(0.0,),
            agreement=CONSISTENT,
        ),
    )
    timing = True
    steady = True
    even = True
    first_order = True
    shared = True
    linear = (Coefficient("delay", "s", low=-LARGEST_S, high=LARGEST_S),)
    alike = ("actuator_lag", "joint_elasticity")
    separate_by = (
        "fast reversals and steps of acceleration; stamp positions and torques with one"
        " clock, or log a common trigger"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return the change of the modelled torque per second of delay."""
        around = settings["around"]
        law = Law(terms=("-tau_rate",), memories={"tau_rate": Rate("tau")})
        if abs(around) >= SMALL_S:
            memories = {"tau_late": Late(around)}
            terms = ("(tau_late - tau) / around",)
            law = Law(terms=terms, numbers=settings, memories=memories)
        return dict.fromkeys(touched(robot, joint), law)

    def steady_columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Compute the change from the torque a little earlier on the way."""
        change = steady_change(scene, joint, -settings["around"])
        return {j: -X for j, X in change.items()}

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Shift the torque back."""
        return delayed(tau, -float(c[0]), rate_hz)
