"""What a diagnosis says beside its findings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.loud import Loud
from seqid_cli.robot.types import Robot

OFFSET_SHOWS = 0.7  # of what is left: torque of a time offset that is worth a note


def loud_notes(loud: Sequence[Loud], robot: Robot) -> tuple[str, ...]:
    """Joints at which more is left than noise accounts for."""
    return tuple(
        f"joint {robot.joint_names[one.joint]}: what is left is {one.times:.1f} times what torque "
        "noise and encoder account for"
        for one in loud
    )


def offset_notes(found: Investigation, robot: Robot) -> tuple[str, ...]:
    """Joints whose torque and position are apart by less than a sample, where that shows."""
    search = found.search
    offsets, notes = search.offsets(search.system()), []
    for j, name in enumerate(robot.joint_names):
        X, offset = search.base.timing[j], offsets[j]
        shown = abs(offset) * float(np.sqrt(np.mean(X**2))) if len(X) else 0.0
        if search.timed[j] and shown > OFFSET_SHOWS * float(search.noise[j]):
            side = "early" if offset > 0 else "late"
            notes.append(
                f"joint {name}: torque is {1e3 * abs(offset):.1f} ms {side} against position, less "
                "than a sample, and taken for the logger's own; logs at a higher rate would tell a "
                "skew or a lag"
            )
    return tuple(notes)
