"""Friction that changes with temperature: grease thins while the gear warms up.

    tau = h (a_c s(v) + a_v v)
    h = T - T_0 where temperature is logged, exp(-t / T_w) otherwise

T [degC] is the logged temperature, T_0 that at which the file's friction was identified
(the mean over the logs, where the file does not know it), a_c [N m/K] and a_v [N m
s/(rad K)] how Coulomb and viscous friction change with it. Without a sensor the gear
warms up with the time constant T_w [s] on the clock that the logs share, t [s] since
the first of them began, and a_c [N m], a_v [N m s/rad] is what a cold start adds. Logs
that share no clock count as begun equally cold.

A time constant is told from a drift, or from any other change of friction, only where
the logs see the warm-up go by: several time constants within a log, or logs on a shared
clock that cover one. Longer ones are not tried. Shorter ones than a minute are not
either: a gear is too heavy to warm up within seconds, and what changes in those is the
beginning of a motion. Where a logged temperature stays what it is, nothing warms up.

Simoni, Beschi, Legnani, Visioli, "Modelling the temperature in joint friction of
industrial manipulators", Robotica 37(5), 2019; Bittencourt, Gunnarsson, "Static
friction in a robot joint: modeling and identification of load and temperature effects",
J. Dyn. Sys. Meas. Control 134(5), 2012.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    FrictionEffect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scene, Scenes, session
from seqid_cli.effects.smooth import Axis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Time constants within one log: after three of them 95 % of the warm-up is over.
SEVERAL = 3.0
LEAST_KELVIN = 2.0  # of change, below which a logged temperature says nothing
# The kilograms of a gear warm up in minutes.
SHORTEST_S = 60.0
SHORTEST_IN_FILES_S = 5.0  # files of before have shorter ones
LONGEST_S = 1e5
TIME_CONSTANTS = 8


class ThermalFriction(FrictionEffect):
    """Coulomb and viscous friction that follow the temperature."""

    name = "thermal_friction"
    settings = (
        Setting(
            "warm_up_time",
            "s",
            low=SHORTEST_IN_FILES_S,
            high=LONGEST_S,
            logarithmic=True,
        ),
        Setting("logged", "1", low=0.0, high=1.0, continuous=False),
        Setting(
            "reference_temperature", "degC", low=-60.0, high=200.0, continuous=False
        ),
    )
    over = "session_time"
    sided = True
    alike = ("torque_constant", "drift", "friction_change")
    by_motion = False
    separate_by = (
        "the same trajectory cold, after five and after twenty minutes of motion, with"
        " motor temperature logged if the drive offers it; payload and mounting"
        " untouched"
    )

    def possible(self, scenes: Scenes, joint: Joint) -> bool:
        """Return whether logs or file do not know the temperature.

        A steady temperature follows no law of time.
        """
        surface = None if joint is None else scenes[0].model.surfaces[joint]
        is_logged = all(scene.temperature is not None for scene in scenes)
        in_file = surface is not None and surface.temperature is not None
        return not (is_logged and in_file) and self.available(scenes, joint)

    def local(self, settings: Settings) -> bool:
        """Return whether no logged temperature is needed."""
        return not settings["logged"]

    def axis(self, joint: int, settings: Settings) -> Axis | None:
        """Return the logged temperature, or time."""
        if settings["logged"]:
            return Axis("temperature", joint)
        return super().axis(joint, settings)

    def searched(self, settings: Settings) -> int:
        """Return 1 for the time constant, without a logged temperature."""
        return 0 if settings["logged"] else 1

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the change of Coulomb and of viscous friction."""
        if settings["logged"]:
            return (
                Coefficient("coulomb_per_kelvin", "N m/K"),
                Coefficient("viscous_per_kelvin", "N m s/(rad K)"),
            )
        return (
            Coefficient("coulomb_when_cold", "N m"),
            Coefficient("viscous_when_cold", "N m s/rad"),
        )

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return time constants that the logs cover.

        With a logged temperature the time constant does nothing.
        """
        span = session(scenes)
        change = _logged_change(scenes, joint)
        if change is not None and change >= LEAST_KELVIN:
            return {
                "warm_up_time": [float(np.clip(span, SHORTEST_S, LONGEST_S))],
                "logged": [1.0],
                "reference_temperature": [_reference(scenes, joint)],
            }

        longest = longest_warm_up(scenes)
        times = []
        if longest >= SHORTEST_S and change is None:
            shortest = max(0.04 * span, SHORTEST_S)
            constants = np.geomspace(shortest, longest, TIME_CONSTANTS)
            times = np.clip(constants, SHORTEST_S, LONGEST_S).tolist()
        return {
            "warm_up_time": times,
            "logged": [0.0],
            "reference_temperature": [0.0],
        }

    def plausible(
        self, scenes: Scenes, joint: Joint, settings: Settings, c: Array
    ) -> bool:
        """Return whether the logs cover the time constant as well."""
        longest = longest_warm_up(scenes)
        covered = (
            settings["logged"] or SHORTEST_S <= settings["warm_up_time"] <= longest
        )
        return bool(covered) and super().plausible(scenes, joint, settings, c)

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return direction and velocity, each times the temperature or the warm-up."""
        heat = "exp(-t / warm_up_time)"
        if settings["logged"]:
            heat = "temperature - reference_temperature"
        law = Law(
            terms=("heat * sign(dq)", "heat * dq"),
            parts={"heat": heat},
            numbers=settings,
        )
        return {joint: law}


def longest_warm_up(scenes: Scenes) -> float:
    """Return the longest time constant [s] that logs without a temperature can tell.

    Several logs on a shared clock must cover it; within one log, or where each log
    begins a clock of its own, it must go by several times.
    """
    on_one_clock = len(scenes) > 1 and all(scene.shared_clock for scene in scenes)
    if on_one_clock:
        return session(scenes)
    return session(scenes) / SEVERAL


def _celsius(scene: Scene, joint: int) -> Array:
    """Return the logged temperature (N,) degC; zero where there is none."""
    if scene.temperature is None:
        return np.zeros(scene.samples)
    return np.nan_to_num(scene.temperature[:, joint], nan=0.0, posinf=0.0, neginf=0.0)


def _logged_change(scenes: Scenes, joint: int) -> float | None:
    """Return by how many kelvin a joint's temperature changes, where all logs have it.

    A change from the temperature of the friction trials counts as well. None where a
    log has no temperature, or none that can be.
    """
    of_logs = [
        scene.temperature[:, joint] for scene in scenes if scene.temperature is not None
    ]
    if len(of_logs) < len(scenes):
        return None

    celsius = np.concatenate(of_logs)
    is_physical = np.all((celsius > -60.0) & (celsius < 200.0))
    if not is_physical:
        return None
    return float(np.ptp(np.append(celsius, _reference(scenes, joint))))


def _reference(scenes: Scenes, joint: int) -> float:
    """Return the temperature [degC] of the file's friction, or else the logs' mean."""
    surface = scenes[0].model.surfaces[joint]
    if surface is not None and surface.temperature is not None:
        return surface.temperature
    return float(np.mean(np.concatenate([_celsius(scene, joint) for scene in scenes])))
