"""Options of `drive` and `replay`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.identify.options import LogOptions


@dataclass(frozen=True, kw_only=True)
class DriveOptions(LogOptions):
    """Options of the identification of the controllers.

    With `no_torque` the logged torque is left aside, and the torque that the model
    computes from the motion takes its place.
    """

    no_torque: bool = False


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(LogOptions):
    """Options of a replay; `window_s` [s] is what is simulated from one state."""

    window_s: float = 1.0
