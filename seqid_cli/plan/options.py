"""Options of a plan; kept free of heavy imports for the command line."""

from dataclasses import dataclass
from typing import Literal

What = Literal[
    "friction",
    "gravity",
    "imu-calib",
    "inertia",
    "payload",
    "validation",
    "all",
    "discriminate",
]


@dataclass(frozen=True)
class PlanOptions:
    """Durations in s; see `docs/reference/deciding_numbers.md` for the numbers.

    `duration_s` is the time that the moves of the inertia stage may take, `together`
    whether all joints move at once in them instead of two, `pool` how many moves are
    drawn to choose from and `sweeps` how often each chosen one is refined. Each move
    lasts `move_s` (None: `move_ramps` times `ramp_s`), gets from rest to the largest
    speed in `ramp_s`, and uses a `share` of all limits, the rest of which is for the
    controller's overshoot; `locked` joints are kept still, and `speed_scale` slows down
    the files, for the first run on the robot. `between` are the two effects at `joint`
    to tell apart, `size_share` their torque over the joint's usual one. `load_kg` is
    the heaviest payload, with which torques are checked. With a `floor` no point of the
    arm comes below the base plane, across gravity through the base frame's origin. No
    link comes into the boxes `keep_out` or out of `workspace`: x, y, z of two corners,
    m in the base frame.
    """

    duration_s: float = 150.0
    move_s: float | None = None
    move_ramps: float = 20.0
    together: bool = False
    pool: int = 600
    sweeps: int = 2
    seed: int = 0
    ramp_s: float = 0.5
    share: float = 0.95
    locked: tuple[str, ...] = ()
    speed_scale: float = 1.0
    between: tuple[str, ...] = ()
    joint: str | None = None
    size_share: float = 0.05
    load_kg: float = 0.0
    keep_out: tuple[tuple[float, ...], ...] = ()
    workspace: tuple[float, ...] | None = None
    floor: bool = True

    @property
    def length_s(self) -> float:
        """How long each move lasts, s."""
        return self.move_ramps * self.ramp_s if self.move_s is None else self.move_s
