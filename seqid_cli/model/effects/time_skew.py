"""Torque is logged late or early against the positions.

    tau_logged(t) = tau(t - d)

d [s] is the delay. To first order the logged torque differs by -d dtau/dt; the setting `around`
(d_0) makes the column exact near d = d_0:

    X = (tau(t - d_0) - tau(t)) / d_0.

Friction's steps are shifted with the rest, which is what tells a delay from an elastic joint.
A delay and a lag agree to first order and part in the second, d^2/2 against T^2 times the second
derivative.
"""

import numpy as np
from scipy.ndimage import shift

from seqid_cli.model.effects.effect import Coefficient, Columns, Setting, Settings
from seqid_cli.model.effects.measurement import (
    SMALL_S,
    TorqueMeasurement,
    of_modelled,
    steady_change,
)
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.typing import Array

LARGEST_S = 0.1
# Free base parameters take up part of a delay, so that the residual's own comes out too short.
CONSISTENT = 1.5  # ratio of d to d_0 beyond which the column does not belong to the coefficient


class TimeSkew(TorqueMeasurement):
    """Modelled torque, shifted, minus itself; of one joint, or one delay of all (joint None)."""

    name = "time_skew"
    settings = (
        Setting("around", "s", -LARGEST_S, LARGEST_S, False, grid=(0.0,), agreement=CONSISTENT),
    )
    timing = steady = even = first_order = shared = True
    linear = (Coefficient("delay", "s", low=-LARGEST_S, high=LARGEST_S),)
    alike = ("actuator_lag", "joint_elasticity")
    separate_by = (
        "fast reversals and steps of acceleration; stamp positions and torques with one clock, or "
        "log a common trigger"
    )

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Change of the modelled torque per second of delay."""
        rate, valid, around = scene.motion.rate_hz, scene.motion.valid, settings["around"]
        if abs(around) < SMALL_S:
            return of_modelled(scene, joint, lambda tau: -differentiate(tau, rate, valid)[0])
        return of_modelled(scene, joint, lambda tau: (delayed(tau, around, rate) - tau) / around)

    def steady_columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """The same from the torque a little earlier on the way."""
        return {j: -X for j, X in steady_change(scene, joint, -settings["around"]).items()}

    def true_torque(self, tau: Array, rate_hz: float, settings: Settings, c: Array) -> Array:
        """Shift back."""
        return delayed(tau, -float(c[0]), rate_hz)


def delayed(values: Array, delay_s: float, rate_hz: float) -> Array:
    """Values (N, k) as they were `delay_s` before, held at the ends, by cubic splines."""
    if not len(values):
        return values.copy()
    return np.asarray(shift(values, (delay_s * rate_hz, 0.0), order=3, mode="nearest"))
