"""What a message decoder is: a batch of payloads in, one row of numbers per message out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps

Decode = Callable[[Sequence[bytes]], "Decoded"]

JOINT_QUANTITIES = ("position", "velocity", "effort")
IMU_FIELDS = tuple(
    (name, axis) for name in ("linear_acceleration", "angular_velocity") for axis in "xyz"
)


@dataclass(frozen=True)
class Decoded:
    """M messages: header stamps, values (NaN where missing), and which could be decoded.

    Rows of joint states are position, velocity and effort of the wanted joints side by side
    (M, 3 n); rows of IMUs are linear acceleration and angular velocity (M, 6).
    """

    stamp_ns: Stamps
    values: Array
    good: Mask

    @classmethod
    def empty(cls, count: int, width: int) -> Decoded:
        """Make a batch in which nothing is decoded yet."""
        return cls(
            np.zeros(count, np.int64), np.full((count, width), np.nan), np.zeros(count, np.bool_)
        )


def put(out: Decoded, rows: Rows, part: Decoded) -> None:
    """Put messages decoded by themselves into their rows of a batch."""
    out.stamp_ns[rows] = part.stamp_ns
    out.values[rows] = part.values
    out.good[rows] = part.good


class NameMap:
    """Which entry of a JointState belongs to which joint of the robot.

    Remembers the names that messages bring, for the message that none of them fits. `effort` says
    what effort is, "torque" or "current": an interface of that name stands in for it.
    """

    _LIMIT = 200

    def __init__(self, joints: Iterable[str], effort: str = "torque") -> None:
        self.joints = tuple(joints)
        self.effort = effort
        self._index = {name: i for i, name in enumerate(self.joints)}
        self.seen: dict[str, None] = {}

    @property
    def width(self) -> int:
        """Values per row."""
        return len(JOINT_QUANTITIES) * len(self.joints)

    def pairs(self, names: Sequence[str]) -> list[tuple[int, int]]:
        """Pair (entry in the message, joint of the robot); of equal names the first counts."""
        found: dict[int, int] = {}
        for entry, name in enumerate(names):
            if len(self.seen) < self._LIMIT:
                self.seen.setdefault(name)
            if name in self._index:
                found.setdefault(self._index[name], entry)
        return [(entry, joint) for joint, entry in found.items()]


def check_lengths(names: int, arrays: Sequence[int]) -> None:
    """Refuse a JointState whose arrays are neither empty nor as long as its names.

    Raises
    ------
    ValueError
        An array has another length.
    """
    for quantity, length in zip(JOINT_QUANTITIES, arrays, strict=True):
        if length not in (0, names):
            raise ValueError(f"{length} values of {quantity} for {names} names")
