"""Options of a plan; kept free of heavy imports for the command line."""

from dataclasses import dataclass
from typing import Literal

from seqid_cli.logs.reading import ALL, LogPart

What = Literal[
    "friction",
    "gravity",
    "imu-calib",
    "inertia",
    "payload",
    "drive",
    "validation",
    "all",
    "discriminate",
]


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Options of a plan; docs/reference/deciding_numbers.md has the numbers' reasons.

    Parameters
    ----------
    duration_s : float
        Time that the moves of the inertia stage may take [s].
    move_s : float, optional
        Length of each move [s]; None for `move_ramps` times `ramp_s`.
    move_ramps : float
        Length of each move, in units of `ramp_s`.
    together : bool
        Whether all joints move at once in the inertia stage, instead of two.
    pool : int
        Number of moves that are drawn to choose from.
    sweeps : int
        How often each chosen move is refined.
    seed : int
        Seed of everything that is drawn.
    ramp_s : float
        Time from rest to the largest speed [s].
    share : float
        Share of all limits that is used; the rest is for the controller's overshoot.
    locked : tuple of str
        Joints that are kept still.
    speed_scale : float
        Factor on the speed in the written files, for the first run on the robot.
    between : tuple of str
        The two effects to tell apart.
    joint : str, optional
        The joint at which the two effects are.
    size_share : float
        Torque of the effects, over the usual torque of the joint.
    bandwidth_hz : float
        Of the position loops, about: a drive is planned up to twice of it [Hz].
    load_kg : float
        Heaviest payload, with which torques are checked [kg].
    keep_out : tuple of tuples of float
        Boxes that no link comes into: x, y, z of two corners, m in the base frame.
    workspace : tuple of float, optional
        Box that no link leaves: x, y, z of two corners, m in the base frame.
    floor : bool
        Whether all points of the arm stay above the base plane, across gravity through
        the base frame's origin.
    part : LogPart
        The part of each log that exists; all of it by default, or what an earlier stage
        used of the same log.
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
    bandwidth_hz: float = 4.0
    load_kg: float = 0.0
    keep_out: tuple[tuple[float, ...], ...] = ()
    workspace: tuple[float, ...] | None = None
    floor: bool = True
    part: LogPart = ALL

    @property
    def length_s(self) -> float:
        """Length of each move [s]."""
        return self.move_ramps * self.ramp_s if self.move_s is None else self.move_s
