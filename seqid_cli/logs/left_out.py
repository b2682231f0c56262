"""Joints of the chain that the robot file leaves out, as a log shows them.

Such a joint is taken as locked, and the arm behind it hangs on the angle at which it
stands. A log that holds its position says which: where it stands the chain is built at
that angle, where it moves the robot file has too few joints for the log.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.publishers import second_publisher
from seqid_cli.logs.raw import Stamps, Stream
from seqid_cli.logs.read import without_absurd
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.tables.name_words import QUANTITIES
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml_schema import Columns
from seqid_cli.robot.types import LockedJoint, Robot
from seqid_cli.typing import Mask

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


def standing_joints(
    path: Path, robot: Robot, reading: Reading = HEADER_STAMPS
) -> list[Standing]:
    """Look up where joints of the chain that the robot file leaves out are in a log."""
    if not robot.locked:
        return []
    standing = []
    arm: list[_ArmSamples] = []
    with local_copy(path) as copy:
        for joint in robot.locked:
            blocks = list(_blocks_of(copy, _alone(joint, robot), reading))
            if not blocks:
                continue
            # Zeros of a second publisher would make a joint that stands look as if it
            # moved. The joints of the robot file tell which messages are the robot's.
            arm = arm or list(_arm_samples(copy, robot, reading))
            parts = [
                block.channels["position"][of_arm.published(block), 0]
                for block, of_arm in zip(blocks, arm, strict=False)
            ]
            q = np.concatenate([np.zeros(0), *parts])
            q = q[np.isfinite(q)]
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


@dataclass(frozen=True, kw_only=True)
class _ArmSamples:
    """Samples (M,) of the arm's joints in a block of a log.

    Attributes
    ----------
    stamp_ns : (M,) array
        When they were logged.
    by_robot : (M,) array
        False for those of a second publisher; for all where two cannot be told apart.
    """

    stamp_ns: Stamps
    by_robot: Mask

    def published(self, joint: Stream) -> Mask:
        """Tell which samples (M,) of a left-out joint are the robot's as well."""
        if np.array_equal(joint.stamp_ns, self.stamp_ns):
            return self.by_robot
        # The joint has a driver of its own. A stranger's message holds the joints of
        # the arm beside it.
        by_stranger = np.isin(joint.stamp_ns, self.stamp_ns[~self.by_robot])
        beside_arm = np.isin(joint.stamp_ns, self.stamp_ns[self.by_robot])
        return np.asarray(~by_stranger | beside_arm)


def _alone(joint: LockedJoint, robot: Robot) -> Robot:
    """Return a robot of one left-out joint, which a log holds by its name if at all."""
    # A log's other channels are those of the joints in the robot file: columns by
    # number are theirs. What holds for the log as a whole holds for this joint.
    channels = structs.replace(
        robot.channels,
        position=_by_name(robot.channels.position),
        names=_by_name(robot.channels.names),
        **dict.fromkeys(QUANTITIES[1:]),
        effort=None,
        # Percent are of the limits in the robot file, which has none of this joint.
        unit="rad" if robot.channels.unit == "percent" else robot.channels.unit,
    )
    return replace(robot, joints=(joint.joint,), imus=(), effects=(), channels=channels)


def _by_name(pattern: Columns | None) -> Columns | None:
    """Return a pattern with {name}, which holds for other joints; None for others."""
    is_general = isinstance(pattern, str) and "{name}" in pattern
    return pattern if is_general else None


def _blocks_of(path: Path, robot: Robot, reading: Reading) -> Iterator[Stream]:
    """Read the joints of a robot block by block, as far as the log holds them."""
    try:
        for raw in LogFile.at(path, reading=reading).blocks(robot):
            yield raw.joints
    except InputError:
        return


def _arm_samples(path: Path, robot: Robot, reading: Reading) -> Iterator[_ArmSamples]:
    """Tell whose samples of the arm's joints are, in the blocks of `_blocks_of`."""
    for block in _blocks_of(path, replace(robot, imus=()), reading):
        joints = without_absurd(block, [])
        by_robot = np.ones(len(joints), np.bool_)
        try:
            strangers = second_publisher(joints, str(path))
        except InputError:
            by_robot = np.zeros(len(joints), np.bool_)
        else:
            if strangers is not None:
                by_robot = ~strangers.rows
        yield _ArmSamples(stamp_ns=joints.stamp_ns, by_robot=by_robot)
