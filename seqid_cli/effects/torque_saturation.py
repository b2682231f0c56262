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

from seqid_cli.effects.effect import Coefficient, GridAxes, Setting, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import ModelledTorque, touched
from seqid_cli.effects.scene import Joint, Scenes
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LOSSES_AT_PEAK = (0.0, 0.1)  # b_0 tau_peak^2
# Ratio of b to b_0 beyond which the column does not belong to the coefficient
CONSISTENT = 4.0


class TorqueSaturation(ModelledTorque):
    """Torque constant that falls with the square of the current."""

    name = "torque_saturation"
    drive = True
    steady = True
    even = True
    first_order = True
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
        """Return b_0 that lose up to a tenth of the modelled peak torque."""
        joints = slice(None) if joint is None else joint
        peak = 0.0
        for scene in scenes:
            torque = np.abs(scene.modelled[scene.motion.usable, joints])
            peak = max(peak, float(np.max(torque, initial=0.0)))
        if peak <= 0.0:
            return {"around": [0.0]}
        return {"around": [loss / peak**2 for loss in LOSSES_AT_PEAK]}

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return measured minus true torque per unit of b.

        Beyond the largest torque that the law has, the measured torque is held.
        """
        b_0 = settings["around"]
        if b_0 <= 0.0:
            law = Law(terms=("tau * tau * tau",))
            return dict.fromkeys(touched(robot, joint), law)

        # The cubic equation for m is solved by a sine. Its m cubed is the same as
        # (measured - true) / b_0, which loses its digits where both are small.
        law = Law(
            terms=("measured * measured * measured",),
            parts={
                "x": "min(max(1.5 * root * tau, -1.0), 1.0)",
                "measured": "2.0 * sin(asin(x) / 3.0) / root",
            },
            numbers={"root": float(np.sqrt(3.0 * b_0))},
        )
        return dict.fromkeys(touched(robot, joint), law)

    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Apply the law, held where it would fall again."""
        b = max(float(c[0]), 0.0)
        turning_point = 1.0 / np.sqrt(3.0 * b) if b > 0.0 else np.inf
        measured = np.clip(tau, -turning_point, turning_point)
        return np.asarray(measured * (1.0 - b * measured**2))
