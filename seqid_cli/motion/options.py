"""What a user may set about filtering; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionOptions:
    """`cutoff_hz` overrides the low-pass cut-off that is otherwise chosen from each log."""

    cutoff_hz: float | None = None
