"""Channels that have no values for a while in which the rest of the log goes on."""

from collections.abc import Iterator

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.clocks import gap_limit
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array


def hole_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find holes in the position and the torque of every joint."""
    effort = data.effort()
    channels = [("position", data.joints.channels["position"]), *([effort] if effort else [])]
    for quantity, values in channels:
        if np.isfinite(values).all():
            continue
        for j, joint in enumerate(data.robot.joints):
            holes = _holes(data.t, values[:, j])
            if holes:
                start, end = max(holes, key=lambda hole: hole[1] - hole[0])
                text = (
                    f"has no values from {start:.3f} to {end:.3f} s"
                    + (f" and {len(holes) - 1} more times" if len(holes) > 1 else "")
                    + "; these samples are left out"
                )
                yield found("channel_hole", text, joint=joint.name, channel=quantity)


def _holes(t: Array, values: Array) -> list[tuple[float, float]]:
    """List the times between present values that are longer than any other gap is taken for."""
    present = np.flatnonzero(np.isfinite(values))
    if len(present) < 3:
        return []
    steps = np.diff(t[present])
    usual = int(np.median(np.diff(present)))
    wide = (steps > gap_limit(steps)) & (np.diff(present) > 2 * usual)  # rows without it between
    return [(float(t[present[k]]), float(t[present[k + 1]])) for k in np.flatnonzero(wide)]
