"""What a user may set per stage; kept free of heavy imports for the command line."""

from dataclasses import dataclass, field
from typing import Literal

from seqid_cli.motion.options import MotionOptions

TimeSource = Literal["header", "log"]
Source = Literal["auto", "encoder", "imu", "fused"]


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """How logs are read.

    `cutoff_hz` is the low-pass cut-off; that of the model, or chosen from the logs, where it is
    None. `time_source` says which stamps of an MCAP log count: those in the messages, or the times
    of logging. With `skip_failed` logs that cannot be used are left out, and warned of.
    """

    cutoff_hz: float | None = None
    time_source: TimeSource = "header"
    skip_failed: bool = False


@dataclass(frozen=True, kw_only=True)
class FrictionOptions(LogOptions):
    """Orders m and l of Eq. 8 and 10, and the threshold beta of Eq. 11.

    Orders left None are raised while speeds that were left out are predicted better; with a `beta`
    the raising stops as soon as Eq. 11 holds at it.
    """

    position_order: int | None = None
    velocity_order: int | None = None
    beta: float | None = None


@dataclass(frozen=True, kw_only=True)
class RigidOptions(LogOptions):
    """Where joint motion comes from, and which parameters are allowed.

    `source` "auto" is "fused" where a log has a calibrated IMU, else "encoder". `consistent` allows
    only parameters that bodies with positive density and rotors of positive inertia can have.
    """

    source: Source = "auto"
    consistent: bool = False


@dataclass(frozen=True, kw_only=True)
class SimultaneousOptions(RigidOptions):
    """`offset` says whether each joint's friction has a constant torque besides."""

    offset: bool = True


@dataclass(frozen=True, kw_only=True)
class PredictOptions(LogOptions):
    """`with_unexplained` adds the smooth terms that no known effect explains."""

    source: Source = "auto"
    with_unexplained: bool = False


@dataclass(frozen=True)
class InertiaOptions:
    """`source` is where joint motion comes from: "auto", "encoder", "imu" or "fused".

    `slides_from` are the speeds [rad/s; m/s where prismatic], one per joint, from which a joint
    certainly slides in a prediction. None: what the model's own friction says. Errors of two models
    are compared on the same samples only where both have the same.

    `neighbours` are multiples of the cut-off at which the inertia stage looks at its parameters
    again (see `cutoff_check`); a log that is passed over is not looked at again.
    """

    motion: MotionOptions = field(default_factory=MotionOptions)
    source: str = "auto"
    slides_from: tuple[float, ...] | None = None
    neighbours: tuple[float, ...] = (0.7, 1.4)
