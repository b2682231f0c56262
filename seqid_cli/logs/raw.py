"""What a reader hands over: samples as they were logged, each stream with its own stamps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.robot.types import Imu

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Stamps = NDArray[np.int64]
Rows = NDArray[np.intp]
TimeSource = Literal["header", "log"]

STAMP_LIMIT_NS = 4_000_000_000_000_000_000  # year 2096; differences stay inside 64 bits
ACCELEROMETERS = "accelerometers"
GYRO = "gyro"


@dataclass(frozen=True)
class Stream:
    """Samples that share stamps.

    `channels[quantity]` is (M, w), NaN where a sample lacks the value. Joint streams hold position
    [rad], velocity [rad/s], torque, load [N m], current [A], link_position [rad], temperature
    [degC] by the robot's joints; IMU streams `accelerometers` [m/s^2] and `gyro` [rad/s].
    """

    name: str
    stamp_ns: Stamps  # (M,)
    channels: dict[str, Array]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def take(self, rows: Rows | Mask | slice) -> "Stream":
        """Select rows (indices, mask or slice)."""
        channels = {name: values[rows] for name, values in self.channels.items()}
        return replace(self, stamp_ns=self.stamp_ns[rows], channels=channels)


@dataclass(frozen=True)
class RawLog:
    """One log, not yet on one time base; an IMU's streams follow its accelerometers' order."""

    joints: Stream
    imus: dict[str, tuple[Stream, ...]] = field(default_factory=dict)
    partial: str = ""
    warnings: tuple[str, ...] = ()
    log_minus_header_s: float | None = None
    prefer_current: bool = False


def joined(parts: Sequence[Stream]) -> Stream:
    """Consecutive parts of a stream; a quantity that some lack is missing there."""
    there = [part for part in parts if len(part)]
    if not there:
        return parts[0]
    widths = {name: own.shape[1] for part in there for name, own in part.channels.items()}
    channels: dict[str, Array] = {}
    for name, width in widths.items():
        own = (p.channels.get(name, np.broadcast_to(np.nan, (len(p), width))) for p in there)
        channels[name] = np.concatenate([*own])
    return Stream(there[0].name, np.concatenate([part.stamp_ns for part in there]), channels)


def partly_logged(imu: Imu, missing: Sequence[str], where: str, there: str = "") -> InputError:
    """Make the error for an IMU of which a log has only some channels; `there`: what it holds."""
    message = f"IMU {imu.name!r} is only partly in the log; missing: {', '.join(missing)}"
    hint = f"The robot file gives it {len(imu.positions)} accelerometers"
    hint += f"{' and a gyro' * imu.gyro}: log them all, or correct the robot file."
    return InputError(message, hint=f"{hint} {there}".strip(), where=where)


# Reads the channels that the robot file knows: (path, robot, time source, rows in a block, or None
# for one). Raises InputError: the file is damaged beyond use or lacks a channel.
BlockReader = Callable[..., Iterator[RawLog]]
