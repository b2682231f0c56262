"""The arm touches something, or is touched: J' F for a while, at no time that repeats.

Nothing of it is fitted: the stretches are found as events in time, that several joints
see at once and that no other period of the motion shows, and are left out. Haddadin, De
Luca, Albu-Schaeffer, "Robot collisions: a survey on detection, isolation, and
identification", IEEE Trans. Robotics 33(6), 2017.
"""

from collections.abc import Mapping

from seqid_cli.effects.effect import Effect, Settings
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scenes
from seqid_cli.robot.types import Robot


class ExternalContact(Effect):
    """A name, and what to do about it."""

    name = "external_contact"
    family = "measurement"
    alike = ("backlash",)
    by_motion = False
    separate_by = (
        "the same motion again, at least three times, with nothing within reach: a"
        " contact does not repeat"
    )

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return no law: no torque is touched."""
        return {}

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Return False: it has no column to be screened."""
        return False
