"""Evidence as it stands in documents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry

if TYPE_CHECKING:
    from seqid_cli.discover.results import Evidence, Rival
    from seqid_cli.robot.types import Robot

# What each quantity is measured in: for a revolute joint, for a prismatic one.
_UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "load": ("N m", "N"),
    "temperature": ("degC", "degC"),
    "time": ("s", "s"),
    "time_frequency": ("Hz", "Hz"),
    "speed": ("rad/s", "m/s"),
    "driving_load": ("N m", "N"),
    "wave": ("turn", "turn"),
    "torque": ("N m", "N"),
}


def evidence_entry(shown: Evidence | None, robot: Robot) -> EvidenceEntry | None:
    """Return the residual over what an effect goes with, with the unit of that."""
    if shown is None:
        return None
    return EvidenceEntry(
        joint=shown.joint,
        quantity=shown.quantity,
        of=shown.of,
        unit=_unit_of(shown.quantity, shown.of, robot),
        sided=shown.sided,
        x=list(shown.x),
        count=list(shown.count),
        before=list(shown.before),
        before_spread=list(shown.before_spread),
        after=list(shown.after),
        after_spread=list(shown.after_spread),
    )


def rival_entries(some: Sequence[Rival]) -> list[RivalEntry]:
    """Return what was tried and not taken."""
    return [
        RivalEntry(effect=one.effect, joint=one.joint, log_gain=one.log_gain, why_not=one.why_not)
        for one in some
    ]


def _unit_of(quantity: str, joint: str, robot: Robot) -> str:
    prismatic = robot.joints[robot.joint_names.index(joint)].prismatic
    return _UNITS.get(quantity, ("", ""))[prismatic]
