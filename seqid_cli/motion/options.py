"""What a user may set about motion; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass

# "auto": fused where it can be had; "needed": only where the encoders are much the worse as well.
SOURCES = ("auto", "needed", "encoder", "imu", "fused")


@dataclass(frozen=True)
class MotionOptions:
    """`cutoff_hz` overrides the low-pass cut-off that is otherwise chosen from each log."""

    cutoff_hz: float | None = None
