"""Options of `drive` and `replay`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.identify.options import LogOptions


@dataclass(frozen=True, kw_only=True)
class DriveOptions(LogOptions):
    """Options of the identification of the controllers.

    With `no_torque` the logged torque is left aside, and the torque that the model
    computes from the motion takes its place. With `same_servos` the joints have servos
    of one type, so that what some joints show is a prior of the others.
    """

    no_torque: bool = False
    same_servos: bool = False


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(LogOptions):
    """Options of a replay; `window_s` [s] is what is simulated from one state."""

    window_s: float = 1.0
