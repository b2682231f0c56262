"""Joints of the chain that the robot file leaves out, as a log shows them.

Such a joint is taken as locked, and the arm behind it hangs on the angle at which it
stands. A log that holds its position says which: where it stands the chain is built at
that angle, where it moves the robot file has too few joints for the log.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.read import READERS
from seqid_cli.logs.storage.files import check_log, storage_file
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml_schema import Channels, Columns
from seqid_cli.robot.types import LockedJoint, Robot
from seqid_cli.typing import Array

REMEDY = "Add its [[joint]] table to the robot file, or hold the joint while recording."
# rad (m) that a joint may be shaken by; the arm behind it is no more precise
TRAVEL = 0.01


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Where a joint that the robot file leaves out is in a log, rad (m)."""

    joint: LockedJoint
    log: Path
    low: float
    high: float
    usual: float

    @property
    def moves(self) -> bool:
        """Whether it moves by more than it may be shaken."""
        return self.high - self.low > TRAVEL

    @property
    def message(self) -> str:
        """What is to be said of the joint; empty where it stands as it is taken."""
        unit = "m" if self.joint.prismatic else "rad"
        about = f"lies {self.joint.place} and is not in the robot file; "
        if self.moves:
            return (
                f"{about}it moves in the log, from {self.low:.3g} to {self.high:.3g}"
                f" {unit}"
            )
        if abs(self.usual) <= TRAVEL:
            return ""
        return (
            f"{about}it is taken as locked where it stands in the log, {self.usual:.4g}"
            f" {unit}"
        )


def standing_joints(path: Path, robot: Robot) -> list[Standing]:
    """Look up where joints of the chain that the robot file leaves out are in a log."""
    if not robot.locked:
        return []
    found = []
    with local_copy(path) as copy:
        for joint in robot.locked:
            q = np.concatenate([np.zeros(0), *_positions(copy, robot, joint)])
            if len(q):
                low, usual, high = map(float, np.quantile(q, (0.005, 0.5, 0.995)))
                named = {"joint": joint, "log": path}
                found.append(Standing(**named, low=low, high=high, usual=usual))  # type: ignore[arg-type]
    return found


def in_logged_posture(robot: Robot, standing: Sequence[Standing]) -> Robot:
    """Build the robot with joints that it leaves out where they stand.

    Raises
    ------
    InputError
        A joint moves, or stands elsewhere in another log.
    """
    first: dict[str, Standing] = {}
    for one in standing:
        log = str(one.log)
        if one.moves:
            raise InputError(
                f"joint {one.joint.name!r} {one.message}", hint=REMEDY, where=log
            )
        other = first.setdefault(one.joint.name, one)
        if abs(one.usual - other.usual) > TRAVEL:
            text = (
                f"joint {one.joint.name!r} lies {one.joint.place} and is not in the"
                f" robot file; it stands at {one.usual:.4g}, and at {other.usual:.4g}"
                f" in {other.log}"
            )
            raise InputError(text, hint=REMEDY, where=log)
    positions = {
        name: one.usual for name, one in first.items() if abs(one.usual) > TRAVEL
    }
    if not positions:
        return robot
    return load_robot(robot.source, positions)


def _positions(path: Path, robot: Robot, joint: LockedJoint) -> Iterator[Array]:
    """Read the positions of a joint, if the log has them by its name."""
    # A log's other channels are those of the joints in the robot file: columns by
    # number are theirs, and a unit holds for all.
    names = robot.channels.position
    known: Columns | None = (
        names if isinstance(names, str) and "{name}" in names else None
    )
    channels = Channels(
        time=robot.channels.time,
        position=known,
        unit=robot.channels.unit,
        length_unit=robot.channels.length_unit,
    )
    alone = replace(
        robot, joints=(joint.joint,), imus=(), effects=(), channels=channels
    )
    try:
        for raw in READERS[check_log(path)](storage_file(path), alone):
            q = raw.joints.channels["position"][:, 0]
            yield q[np.isfinite(q)]
    except InputError:
        return
