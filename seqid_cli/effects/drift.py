"""An offset of the measured torque that wanders in proportion to time.

    tau_measured = tau + A + B t

A [N m], B [N m/s]; t [s] counts from the first log where the logs share a clock, else
from the start of each. Beyond the recorded session (`duration`) the offset is held.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import (
    Coefficient,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.measurement import touched
from seqid_cli.effects.scene import Joint, Scenes, session
from seqid_cli.robot.types import Robot


class Drift(Effect):
    """Offset and ramp."""

    name = "drift"
    family = "measurement"
    drive = True
    slow = True
    passes = 1
    settings = (Setting("duration", "s", low=0.0, continuous=False),)
    over = "session_time"
    linear = (Coefficient("offset", "N m"), Coefficient("rate", "N m/s"))
    alike = ("torque_bias", "thermal_friction")
    by_motion = False
    separate_by = (
        "ten seconds at rest with the brakes on at the start and at the end of the"
        " session, and the first log repeated as the last"
    )

    def axes(self, scenes: Scenes, joint: Joint) -> GridAxes:
        """Return the session's end as the only duration."""
        return {"duration": [session(scenes)]}

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return a constant and the time, held beyond the session."""
        law = Law(terms=("1.0", "min(max(t, 0.0), duration)"), numbers=settings)
        return dict.fromkeys(touched(robot, joint), law)
