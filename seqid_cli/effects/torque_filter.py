"""The driver logs a torque that it has averaged or low-passed, positions as they are.

    tau_logged(t) = 1/T int_(t-T)^t tau(u) du          (lowpass 0: moving average)
    T dtau_logged/dt + tau_logged = tau                (lowpass 1: first order)

T [s] is the length of the window, or the time constant. With F(tau; T) for what is
logged of tau, and T_0 the setting `around`, near which the column is exact,

    X = (F(tau; T_0) - tau') / T_0,

tau' being the torque as late as the parameter file has it already: the friction stage
takes the mean lateness of a filter, T/2 or T, for a delay. What is left are corners at
reversals and peaks of the acceleration that are rounded off, at all joints alike; in
the log a rounded corner looks like friction that builds up over a distance. What a
window has taken away no inverse brings back, which would make noise large: the model's
torque goes through the filter instead. Oppenheim, Schafer, "Discrete-time signal
processing", 3rd ed., 2010.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.effects.effect import Coefficient, Columns, Setting, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import OfModelledTorque, steady_change, touched
from seqid_cli.effects.memory import AsLogged, Averaged, Lagged
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

LONGEST_S = 2.0
# Ratio of T to T_0 beyond which the column does not belong to the coefficient: less
# than that of two values of the grid.
CONSISTENT = 2.0
REMEMBERS = 3.0  # filter times, after which little is left of what was before

# Of the filter's memory: how long ago, over T, and with which weight. Gauss's three
# points of a window, and Laguerre's of an exponential, are exact for torque that is a
# polynomial of fifth degree on the way.
POINTS = {
    0.0: ((0.112702, 0.277778), (0.5, 0.444444), (0.887298, 0.277778)),
    1.0: ((0.415775, 0.711093), (2.294280, 0.278518), (6.289945, 0.010389)),
}


class TorqueFilter(OfModelledTorque):
    """Filtered minus unfiltered torque.

    Of one joint, or one filter of all joints (joint None).
    """

    name = "torque_filter"
    timing = True
    steady = True
    even = True
    first_order = True
    shared = True
    settings = (
        Setting(
            "around",
            "s",
            low=0.005,
            high=LONGEST_S,
            continuous=False,
            grid=(0.03, 0.1, 0.3),
            agreement=CONSISTENT,
        ),
        Setting("lowpass", "1", low=0.0, high=1.0, continuous=False, grid=(0.0, 1.0)),
    )
    linear = (Coefficient("filter_time", "s", low=0.0, high=LONGEST_S),)
    alike = ("time_skew", "actuator_lag", "presliding_hysteresis", "joint_elasticity")
    separate_by = (
        "fast reversals and steps of acceleration of several joints: a filter rounds"
        " them off over the same time at all joints, presliding over a distance; or log"
        " the torque without the driver's filter"
    )

    def guessed(
        self, scene: Scene, joint: Joint, settings: Settings
    ) -> Mapping[int, Mask]:
        """Return the samples at which the filter remembers what was before the log."""
        motion = scene.motion
        usable = np.flatnonzero(motion.usable)
        unknown = np.zeros(scene.samples, dtype=bool)
        if len(usable):
            n_remembered = round(REMEMBERS * settings["around"] * motion.rate_hz)
            unknown[: usable[0] + n_remembered] = True
        return dict.fromkeys(touched(scene.robot, joint), unknown)

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return filtered minus logged torque per second of the filter."""
        seconds = settings["around"]
        is_lowpass = settings["lowpass"] > 0.5
        law = Law(
            terms=("(tau_filtered - tau_logged) / around",),
            numbers={"around": seconds},
            memories={
                "tau_filtered": Lagged(seconds) if is_lowpass else Averaged(seconds),
                "tau_logged": AsLogged(),
            },
        )
        return dict.fromkeys(touched(robot, joint), law)

    def steady_columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Compute the mean of the torque a little earlier on the way, less its own."""
        around = settings["around"]
        columns = {j: np.zeros((scene.samples, 1)) for j in touched(scene.robot, joint)}
        for ago, weight in POINTS[float(settings["lowpass"] > 0.5)]:
            seconds = ago * around
            for j, per_second in steady_change(scene, joint, -seconds).items():
                columns[j] -= weight * seconds / around * per_second

        delays_s = scene.model.delays_s
        for j, column in columns.items():
            delay_s = 0.0 if delays_s is None else float(delays_s[j])
            if delay_s != 0.0:
                per_second = steady_change(scene, j, -delay_s)[j]
                column += delay_s / around * per_second
        return columns

    def sharpened(self, settings: Settings, c: Array) -> dict[str, float]:
        """Return settings about the time that was estimated."""
        by_size = super().sharpened(settings, c) or {}
        return {**settings, **by_size}
