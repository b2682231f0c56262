"""What a user may set about motion; kept free of heavy imports for the command line."""

from dataclasses import dataclass, field
from typing import Any

# "auto": fused where it can be had and errs less; "needed": only where encoders are
# much the worse.
SOURCES = ("auto", "needed", "encoder", "imu", "fused")


@dataclass(frozen=True)
class MotionOptions:
    """How logs are filtered.

    Attributes
    ----------
    cutoff_hz : float, optional
        The low-pass of all logs; None: each log chooses its own.
    samples_per_cutoff : float
        Samples per period of the cut-off that stay at least; infinite: all.
    origin : str
        Where the cut-off came from, for messages.
    encoder_hz : float, optional
        Cut-off that would suit the encoders alone.
    logs_with_own_cutoff : frozenset of str
        SHA-256 of logs that choose for themselves.
    kept : dict, optional
        Motions of logs that are worked on again and again (see `log_motion`).
    """

    cutoff_hz: float | None = None
    samples_per_cutoff: float = 10.0
    origin: str = ""
    encoder_hz: float | None = None
    logs_with_own_cutoff: frozenset[str] = frozenset()
    kept: dict[Any, Any] | None = field(default=None, compare=False, repr=False)
