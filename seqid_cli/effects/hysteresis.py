"""A rope, hose or cable that rubs: its torque lags behind the position, at any speed.

    tau = F z,    dz/dq = (1 - s |z|^n (1 + s) / 2) / x_0,    s = sign(z dq)

z [-] is the state, within +-1, F [N m] its largest torque and x_0 [rad] the way over
which it settles after a turn: tenths of a radian, where presliding takes milliradians.
The law is Bouc's and Wen's with equal halves: it unwinds along a straight line, and
winds up the more sharply the larger the setting `sharpness` n. With n = 0 it is Dahl's,

    dz/dq = (1 - z sign(dq)) / x_0.

z depends on the way alone, not on the time: it keeps its value at rest, and is never
set back within a log. A log begins with z = 0. Wen, "Method for random vibration of
hysteretic systems", J. Engineering Mechanics Division 102(2), 1976; Dahl, "A solid
friction model", Aerospace Corp. TOR-0158, 1968.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import (
    Coefficient,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.memory import Rope
from seqid_cli.effects.scene import Scenes, moves, travel
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

DISTANCES = (0.06, 0.13, 0.28)  # rad
# Of the travel, beyond which nothing settles: that is a spring.
LONGEST = 0.4


class Hysteresis(Effect):
    """State of a rope that rubs, over the joint's position."""

    name = "hysteresis"
    family = "transmission"
    steady = True
    even = True
    settings = (
        Setting("hysteresis_distance", "rad", low=0.03, high=2.0, logarithmic=True),
        Setting("sharpness", "1", low=0.0, high=2.0, continuous=False),
    )
    linear = (Coefficient("hysteresis_torque", "N m", low=0.0),)
    alike = ("presliding_hysteresis", "spring", "friction_change", "nonlinear_viscous")
    separate_by = (
        "small and large strokes about the same place, each slow and fast: the loop"
        " over the position keeps its shape at any speed, and is smaller in small"
        " strokes"
    )

    def local(self, settings: Settings) -> bool:
        """Return False: the state remembers turns, however long ago."""
        return False

    def available(self, scenes: Scenes, joint: int) -> bool:
        """Return whether the joint moves in any log."""
        return moves(scenes, joint)

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return ways within which the joint turns, and all laws."""
        longest = LONGEST * travel(scenes, joint)
        distances = [distance for distance in DISTANCES if distance < longest]
        return {"hysteresis_distance": distances, "sharpness": [0.0, 1.0, 2.0]}

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the state."""
        rope = Rope(settings["hysteresis_distance"], round(settings["sharpness"]))
        return {joint: Law(terms=("1.0 * rope",), memories={"rope": rope})}

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether the rope settles within the travel: else it is a spring."""
        settles = settings["hysteresis_distance"] < LONGEST * travel(scenes, joint)
        return settles and super().plausible(scenes, joint, settings, c)
