"""What a user may set about motion; kept free of heavy imports for the command line."""

from dataclasses import dataclass, field
from typing import Any

# "auto": fused where it can be had; "needed": only where the encoders are much the worse as well.
SOURCES = ("auto", "needed", "encoder", "imu", "fused")


@dataclass(frozen=True)
class MotionOptions:
    """How logs are filtered.

    `cutoff_hz` is the low-pass cut-off of all logs, and `origin` says where it came from; None has
    each log choose its own. After the low-pass `samples_per_cutoff` samples at least stay per
    period of the cut-off; infinite keeps all. `encoder_hz` is the cut-off that would suit the
    encoders alone. Logs of `own` (their SHA-256) choose for themselves whatever the cut-off.

    `kept` is a dictionary in which motions are kept, for whoever works on the same logs again and
    again (see `log_motion`).
    """

    cutoff_hz: float | None = None
    samples_per_cutoff: float = 10.0
    origin: str = ""
    encoder_hz: float | None = None
    own: frozenset[str] = frozenset()
    kept: dict[Any, Any] | None = field(default=None, compare=False, repr=False)
