"""What a user may set about motion; kept free of heavy imports for the command line."""

from dataclasses import dataclass, field
from typing import Any

# "auto": fused where it can be had and errs less; "needed": only where encoders are
# much the worse.
SOURCES = ("auto", "needed", "encoder", "imu", "fused")


@dataclass(frozen=True)
class MotionOptions:
    """How logs are filtered."""

    # the low-pass of all logs; None: each log chooses its own
    cutoff_hz: float | None = None
    # that stay per period of it at least; infinite: all
    samples_per_cutoff: float = 10.0
    origin: str = ""  # where the cut-off came from
    encoder_hz: float | None = None  # that would suit the encoders alone
    # whether the jerk is known well enough to estimate delays by it
    reads_delays: bool = True
    own: frozenset[str] = frozenset()  # SHA-256 of logs that choose for themselves
    # Motions of logs that are worked on again and again (see `log_motion`).
    kept: dict[Any, Any] | None = field(default=None, compare=False, repr=False)
