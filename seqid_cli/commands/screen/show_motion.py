"""Where the motion of the logs came from: one line, and a warning for every IMU left aside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import median

from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.params.schema import MotionUse


def show_motion(screen: Screen, uses: Sequence[MotionUse]) -> None:
    """Say which source the motion came from and what that gained, and warn of IMUs left aside."""
    for warning, count in Counter(w for use in uses for w in use.warnings).items():
        if count > 1:
            screen.warn(f"{warning} ({count} of {len(uses)} logs)")
        else:
            log = next(use.log for use in uses if warning in use.warnings)
            screen.warn(f"{log}: {warning}")
    line = motion_line(uses)
    if line:
        screen.note(line)


def motion_line(uses: Sequence[MotionUse]) -> str:
    """Return the sources of motion in one line; nothing where no IMU could take part."""
    if not any(use.imus or use.warnings for use in uses):
        return ""
    kinds = Counter((use.source, tuple(use.imus)) for use in uses)
    parts = []
    for (source, imus), count in kinds.items():
        with_imus = f" ({', '.join(imus)})" if imus else ""
        parts.append(f"{source}{with_imus} in {count} of {len(uses)} logs")
    return "motion: " + ", ".join(parts) + _gain([use for use in uses if use.imus])


def _gain(uses: Sequence[MotionUse]) -> str:
    pairs = [
        (use.acceleration_error[joint], use.encoder_error[joint])
        for use in uses
        for joint in use.acceleration_error
    ]
    if not pairs:
        return ""
    now, before = (median(values) for values in zip(*pairs, strict=True))
    return (
        f"; acceleration known to {number(now, 2)} rad/s^2, by the encoders alone"
        f" {number(before, 2)} (medians)"
    )
