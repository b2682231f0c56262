"""The torque constant falls with current: iron saturates.

    tau = tau_measured (1 - b tau_measured^2),      tau_measured = k_t N i

b [1/(N m)^2] is the share of torque lost per torque squared. To first order the
measured torque exceeds the true one by b tau^3; the setting `around` (b_0) makes the
column exact near b = b_0:

    X = (m(tau; b_0) - tau) / b_0,      m (1 - b_0 m^2) = tau.

The cubic law is the first term of any saturation that is odd in the current. Pillay,
Krishnan, "Modeling, simulation, and analysis of permanent-magnet motor drives, part I",
IEEE Trans. Ind. Appl. 25(2), 1989, has the linear law that it departs from.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, GridAxes, Setting, Settings
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.measurement import ModelledTorque, touched
from seqid_cli.model.effects.scene import Joint, Scenes
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LOSSES_AT_PEAK = (0.0, 0.1)  # b_0 tau_peak^2
# ratio of b to b_0 beyond which the column does not belong to the coefficient
CONSISTENT = 4.0


class TorqueSaturation(ModelledTorque):
    """Torque constant that falls with the square of the current."""

    name = "torque_saturation"
    drive = steady = even = first_order = True
    settings = (
        Setting("around", "1/(N m)^2", low=0.0, continuous=False, agreement=CONSISTENT),
    )
    over = "load"
    linear = (Coefficient("saturation", "1/(N m)^2", low=0.0),)
    alike = ("load_dependent_friction", "gear_efficiency", "torque_constant")
    separate_by = (
        "the same high torque at both directions of motion: hold or lift slowly the"
        " largest load and lower it again; saturation is the same both ways, gear"
        " losses change sign"
    )

    def axes(self, scenes: Scenes, joint: Joint) -> GridAxes:
        """Up to a fifth of the modelled peak torque lost."""
        which = slice(None) if joint is None else joint
        seen = (np.abs(scene.modelled[scene.motion.usable, which]) for scene in scenes)
        peak = max(float(np.max(torque, initial=0.0)) for torque in seen)
        return {
            "around": (
                [loss / peak**2 for loss in LOSSES_AT_PEAK] if peak > 0.0 else [0.0]
            )
        }

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Measured minus true torque per unit of b; beyond the law's largest torque it is held."""
        law = Law(terms=("tau * tau * tau",))
        b = settings["around"]
        if b > 0.0:
            numbers = {"root": float(np.sqrt(3.0 * b))}
            parts = {"x": "min(max(1.5 * root * tau, -1.0), 1.0)"}
            parts["measured"] = "2.0 * sin(asin(x) / 3.0) / root"
            # The same as (measured - true) / b, which loses its digits where both are
            # small.
            law = Law(
                terms=("measured * measured * measured",), parts=parts, numbers=numbers
            )
        return dict.fromkeys(touched(robot, joint), law)

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Apply the law, held where it would fall again."""
        b = max(float(c[0]), 0.0)
        top = 1.0 / np.sqrt(3.0 * b) if b > 0.0 else np.inf
        held = np.clip(tau, -top, top)
        return np.asarray(held * (1.0 - b * held**2))
