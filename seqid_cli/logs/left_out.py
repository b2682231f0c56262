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
    """Position in a log of a joint that the robot file leaves out, rad (m)."""

    joint: LockedJoint
    log: Path
    low: float
    high: float
    usual: float

    @property
    def moves(self) -> bool:
        """True where it moves by more than it may be shaken."""
        return self.high - self.low > TRAVEL

    @property
    def message(self) -> str:
        """A note on the joint; empty where it stands as it is taken."""
        unit = "m" if self.joint.prismatic else "rad"
        place = f"lies {self.joint.place} and is not in the robot file"
        if self.moves:
            return (
                f"{place}; it moves in the log, from {self.low:.3g} to {self.high:.3g}"
                f" {unit}"
            )
        if abs(self.usual) <= TRAVEL:
            return ""
        return (
            f"{place}; it is taken as locked where it stands in the log,"
            f" {self.usual:.4g} {unit}"
        )


def standing_joints(path: Path, robot: Robot) -> list[Standing]:
    """Look up where joints of the chain that the robot file leaves out are in a log."""
    if not robot.locked:
        return []
    standing = []
    with local_copy(path) as copy:
        for joint in robot.locked:
            q = np.concatenate([np.zeros(0), *_positions(copy, robot, joint)])
            if not len(q):
                continue
            # Quantiles: a few samples may be damaged.
            low, usual, high = np.quantile(q, (0.005, 0.5, 0.995)).tolist()
            standing.append(
                Standing(joint=joint, log=path, low=low, high=high, usual=usual)
            )
    return standing


def in_logged_posture(robot: Robot, standing: Sequence[Standing]) -> Robot:
    """Build the robot with joints that it leaves out where they stand.

    Raises
    ------
    InputError
        A joint moves, or stands elsewhere in another log.
    """
    first_by_joint: dict[str, Standing] = {}
    for joint in standing:
        log = str(joint.log)
        name = joint.joint.name
        if joint.moves:
            raise InputError(f"joint {name!r} {joint.message}", hint=REMEDY, where=log)

        first = first_by_joint.setdefault(name, joint)
        if abs(joint.usual - first.usual) > TRAVEL:
            raise InputError(
                f"joint {name!r} lies {joint.joint.place} and is not in the robot file;"
                f" it stands at {joint.usual:.4g}, and at {first.usual:.4g} in"
                f" {first.log}",
                hint=REMEDY,
                where=log,
            )

    positions = {
        name: joint.usual
        for name, joint in first_by_joint.items()
        if abs(joint.usual) > TRAVEL
    }
    if not positions:
        return robot
    return load_robot(robot.source, positions)


def _positions(path: Path, robot: Robot, joint: LockedJoint) -> Iterator[Array]:
    """Read the positions of a joint, if the log has them by its name."""
    # A log's other channels are those of the joints in the robot file: columns by
    # number are theirs, and a unit holds for all.
    pattern: Columns | None = None
    declared = robot.channels.position
    if isinstance(declared, str) and "{name}" in declared:
        pattern = declared
    channels = Channels(
        time=robot.channels.time,
        position=pattern,
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
