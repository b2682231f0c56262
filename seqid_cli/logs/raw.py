"""What a reader hands over: samples as they were logged.

Each stream has its own stamps: what one message or one row says at one time. Stamps
are integer nanoseconds, so sums and differences are exact. M is the number of samples
of a stream, w the number of columns of one quantity, n the number of joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.logs.reading import TimeSource as TimeSource  # as others import it
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Stamps = NDArray[np.int64]
Rows = NDArray[np.intp]

STAMP_LIMIT_NS = 4_000_000_000_000_000_000  # year 2096; differences stay inside 64 bits
ACCELEROMETERS = "accelerometers"
GYRO = "gyro"
OTHER_NAMES = (  # what to do where a log has other names of joints than the robot file
    'Say in the robot file how the log names them: [channels] prefix = "left_", or'
    ' names = ["...", "..."] in the order of the joints.'
)

# An interval between samples is a gap where it is longer than so many median intervals,
# and than 20 ms, over which the curve itself follows an arm.
GAP_INTERVALS = 5.0
GAP_LEAST_S = 0.02
BURSTS = 0.05  # share of longer intervals from which on samples come in bursts


@dataclass(frozen=True)
class Stream:
    """Samples that share stamps.

    `channels[quantity]` is (M, w), NaN where a sample lacks the value. Joint streams
    hold position [rad], velocity [rad/s], torque, load [N m], current [A],
    link_position [rad], temperature [degC] by the robot's joints; IMU streams
    `accelerometers` [m/s^2] and `gyro` [rad/s]. Either joint streams or streams of
    their own hold command [rad], command_velocity [rad/s], command_torque [N m].
    """

    name: str
    stamp_ns: Stamps  # (M,)
    channels: dict[str, Array]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def take(self, rows: Rows | Mask | slice) -> "Stream":
        """Select samples by indices, mask or slice."""
        channels = {name: values[rows] for name, values in self.channels.items()}
        return replace(self, stamp_ns=self.stamp_ns[rows], channels=channels)


@dataclass(frozen=True)
class RawLog:
    """One log, not yet on one time base; an IMU's streams follow its accelerometers."""

    joints: Stream
    imus: dict[str, tuple[Stream, ...]] = field(default_factory=dict)
    partial: str = ""  # what was lost, where the log was salvaged
    warnings: tuple[str, ...] = ()
    log_minus_header_s: float | None = None  # median delay from stamp to logging
    # commands with stamps of their own; others are channels of `joints`
    commands: tuple[Stream, ...] = ()
    prefer_current: bool = False  # current gives the torque, even beside a torque
    # names in the messages of joint states so far, the robot's or not
    names: tuple[str, ...] = ()
    # stamps between which samples are left out because a user said so [ns]
    cuts_ns: tuple[tuple[int, int], ...] = ()


class BlockReader(Protocol):
    """Reads the channels that the robot file knows, block by block.

    Raises InputError where the file is damaged beyond use or lacks a channel.
    """

    def __call__(
        self,
        path: Path,
        robot: Robot,
        time_source: TimeSource = "header",
        *,
        rows: int | None = ...,
    ) -> Iterator[RawLog]:
        """Yield blocks of about `rows` rows; None: the log as one block."""


def joined(parts: Sequence[Stream]) -> Stream:
    """Join consecutive parts of a stream; a quantity that a part lacks is NaN there."""
    filled_parts = [part for part in parts if len(part)]
    if not filled_parts:
        return parts[0]

    widths: dict[str, int] = {}
    for part in filled_parts:
        for quantity, values in part.channels.items():
            widths[quantity] = values.shape[1]

    channels: dict[str, Array] = {}
    for quantity, width in widths.items():
        columns = []
        for part in filled_parts:
            missing = np.broadcast_to(np.nan, (len(part), width))
            columns.append(part.channels.get(quantity, missing))
        channels[quantity] = np.concatenate(columns)
    stamps = np.concatenate([part.stamp_ns for part in filled_parts])
    return Stream(filled_parts[0].name, stamps, channels)


def partly_logged(
    imu: Imu, missing: Sequence[str], where: str, content: str = ""
) -> InputError:
    """Make the error for an IMU of which a log has only some channels.

    Parameters
    ----------
    imu : Imu
        The IMU as the robot file describes it.
    missing : sequence of str
        Names of the columns or topics that the log lacks.
    where : str
        The log, for the message.
    content : str
        What the log holds instead, in words; added to the hint.
    """
    hint = f"The robot file gives it {len(imu.positions)} accelerometers"
    if imu.gyro:
        hint += " and a gyro"
    hint += ": log them all, or correct the robot file."
    return InputError(
        f"IMU {imu.name!r} is only partly in the log; missing: {', '.join(missing)}",
        hint=f"{hint} {content}".strip(),
        where=where,
    )


def gap_limit(
    steps: NDArray[np.floating] | NDArray[np.int64], second: float = 1.0
) -> float:
    """Return the interval from which on samples count as missing.

    It is five median intervals, but at least 20 ms. Where samples come in bursts, more
    than one interval in twenty is beyond that: then it is five mean intervals.

    Parameters
    ----------
    steps : ndarray, (M,)
        Intervals between samples, in any unit of time.
    second : float
        One second in that unit.
    """
    least = GAP_LEAST_S * second
    limit = max(GAP_INTERVALS * float(np.median(steps)), least)
    if np.count_nonzero(steps > limit) > BURSTS * len(steps):
        return max(GAP_INTERVALS * float(np.mean(steps)), least)
    return limit
