"""What a reader hands over: samples as they were logged, each stream with its own stamps.

Here they are put right as well: stamps sorted, without duplicates, from one clock;
whole turns put back that encoders of one turn lose. Stamps are integer nanoseconds, so
sums and differences are exact.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.robot.types import Imu, Robot

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

    `channels[quantity]` is (M, w), NaN where a sample lacks the value. Joint streams
    hold position [rad], velocity [rad/s], torque, load [N m], current [A],
    link_position [rad], temperature [degC] by the robot's joints; IMU streams
    `accelerometers` [m/s^2] and `gyro` [rad/s].
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
    widths = {
        name: own.shape[1] for part in there for name, own in part.channels.items()
    }
    channels: dict[str, Array] = {}
    for name, width in widths.items():
        own = (
            p.channels.get(name, np.broadcast_to(np.nan, (len(p), width)))
            for p in there
        )
        channels[name] = np.concatenate([*own])
    return Stream(
        there[0].name, np.concatenate([part.stamp_ns for part in there]), channels
    )


def partly_logged(
    imu: Imu, missing: Sequence[str], where: str, there: str = ""
) -> InputError:
    """Make the error for an IMU of which a log has only some channels; `there`: what it holds."""
    message = (
        f"IMU {imu.name!r} is only partly in the log; missing: {', '.join(missing)}"
    )
    hint = f"The robot file gives it {len(imu.positions)} accelerometers"
    hint += f"{' and a gyro' * imu.gyro}: log them all, or correct the robot file."
    return InputError(message, hint=f"{hint} {there}".strip(), where=where)


# Reads the channels that the robot file knows: (path, robot, time source, rows in a
# block, or None for one). Raises InputError: the file is damaged beyond use or lacks a
# channel.
BlockReader = Callable[..., Iterator[RawLog]]


TURN = 2.0 * np.pi


def in_turns(
    stream: Stream, robot: Robot, *, slack: float = 0.05
) -> tuple[Stream, dict[str, int]]:
    """Let revolute joints run on where they wrap, within their limits; tell how often each does.

    `slack`: share of a turn by which a step may differ from whole ones. A log that lies
    within the limits (half a turn, where there are none) only with a turn more or less
    is moved by it. The same stream is returned where nothing wraps.
    """
    position = stream.channels["position"]
    moved, found = position.copy(), dict[str, int]()
    for j, joint in enumerate(robot.joints):
        if joint.prismatic:
            continue
        run, times = _unwrapped(position[:, j], slack)
        low, high = joint.position_limits or (-np.pi, np.pi)
        least, most = np.nanmin(run, initial=np.inf), np.nanmax(run, initial=-np.inf)
        fits = [
            k for k in (0, -1, 1) if low <= least + TURN * k and most + TURN * k <= high
        ]
        moved[:, j] = run + TURN * (fits[0] if fits else 0)
        found |= {joint.name: times} if times else {}
    if np.array_equal(moved, position, equal_nan=True):
        return stream, found
    return replace(stream, channels={**stream.channels, "position": moved}), found


def _unwrapped(q: Array, slack: float) -> tuple[Array, int]:
    """Positions (M,) that run on, and how often they wrap: steps of no turn are not more."""
    there = np.flatnonzero(np.isfinite(q))
    d = np.diff(q[there]) / TURN
    turns = np.where(np.abs(np.abs(d) - 1.0) < slack, np.sign(d), 0.0)
    count = int(np.count_nonzero(turns))
    if 2 * count <= np.count_nonzero(np.abs(d) > slack):
        return q, 0
    run = q.copy()
    run[there[1:]] -= TURN * np.cumsum(turns)
    return run, count


GAP_INTERVALS = 5.0
GAP_LEAST_S = 0.02
BURSTS = 0.05


def tidy(stream: Stream) -> tuple[Stream, int, int, list[str]]:
    """Sort a stream by stamp; merge samples of equal stamp, of each joint the first that holds it.

    Where the clock was set back, only the longest stretch of one pass is kept. Returns:
    the stream in the order of time; its steps back in time; samples dropped as
    repeated; warnings.
    """
    backwards = int(np.count_nonzero(np.diff(stream.stamp_ns) < 0))
    warnings: list[str] = []
    if backwards:
        stream = _one_pass(stream, warnings)
        stream = stream.take(np.argsort(stream.stamp_ns, kind="stable"))
        warnings.append(f"{stream.name}: time steps back {backwards} times; sorted")
    stream = _far_stamps_cut(stream, warnings)
    before = len(stream)
    stream, duplicates, conflicts = _merged(stream)
    if duplicates:
        warnings.append(f"{stream.name}: {duplicates} samples repeat a stamp; dropped")
    if conflicts > 0.01 * before:
        text = (
            f"{stream.name}: {conflicts} samples share a stamp with others but hold"
            " other values"
        )
        warnings.append(f"{text}: the clock is too coarse; use the times of logging")
    return stream, backwards, duplicates, warnings


def gap_limit(
    steps: NDArray[np.floating] | NDArray[np.int64], second: float = 1.0
) -> float:
    """Return the interval from which on samples count as missing, by `steps` (M,) in a unit.

    Five median intervals, but at least 20 ms, over which the curve itself follows an
    arm. Where samples come in bursts, more than one interval in twenty is beyond that:
    then five mean ones. `second`: one in that unit.
    """
    least = GAP_LEAST_S * second
    limit = max(GAP_INTERVALS * float(np.median(steps)), least)
    if np.count_nonzero(steps > limit) > BURSTS * len(steps):
        return max(GAP_INTERVALS * float(np.mean(steps)), least)
    return limit


def _one_pass(stream: Stream, warnings: list[str], *, many_steps: int = 100) -> Stream:
    steps = np.diff(stream.stamp_ns)
    forward = steps[steps > 0]
    far = np.flatnonzero(steps < -gap_limit(forward, 1e9)) if forward.size else forward
    if not 0 < far.size <= many_steps:
        return stream
    median = float(np.median(forward))
    jumps = np.array([i for i in far if _overlaps(stream, int(i), median)], np.intp)
    if not len(jumps):
        return stream
    kept = _longest(stream, jumps)
    text = (
        f"the clock jumps back {len(jumps)} times (by up to"
        f" {-steps[jumps].min() * 1e-9:.3g} s) "
    )
    text += (
        "and runs twice over the same time; only the longest stretch is kept,"
        f" {len(kept)} of "
    )
    text += (
        f"{len(stream)} samples. Use the times of logging, or split the log at the jump"
    )
    warnings.append(f"{stream.name}: {text}")
    return kept


def _longest(stream: Stream, cuts: Rows) -> Stream:
    """The longest stretch of samples between cuts, each behind a sample."""
    ends = [0, *(cuts + 1).tolist(), len(stream)]
    return stream.take(slice(*max(pairwise(ends), key=lambda pair: pair[1] - pair[0])))


def _overlaps(stream: Stream, step: int, median_ns: float) -> bool:
    """Tell whether the time behind a step back holds twice the samples that it should."""
    stamps = stream.stamp_ns
    low, high = int(stamps[step + 1]), int(stamps[step])
    region = stream.take((stamps >= low) & (stamps <= high))
    region = region.take(np.argsort(region.stamp_ns, kind="stable"))
    repeated = np.concatenate([[False], np.diff(region.stamp_ns) == 0])
    for values in region.channels.values():
        same = np.isclose(values[1:], values[:-1], rtol=0.0, atol=0.0, equal_nan=True)
        repeated[1:] &= same.all(axis=1)
    return (
        int(np.count_nonzero(~repeated)) > 1.25 * ((high - low) / median_ns + 1.0) + 1.0
    )


def _far_stamps_cut(stream: Stream, warnings: list[str], *, hole_s: int = 60) -> Stream:
    """Cut away stamps so far off (a zero among epoch times, say) that no grid can span them."""
    steps = np.diff(stream.stamp_ns)
    forward = steps[steps > 0]
    if not forward.size:
        return stream
    span = int(stream.stamp_ns[-1]) - int(stream.stamp_ns[0])
    if span / np.median(forward) < 20 * len(stream) + 1_000_000:  # samples on the grid
        return stream
    kept = _longest(stream, np.flatnonzero(steps > hole_s * 1_000_000_000))
    text = (
        f"the stamps span {span * 1e-9:.3g} s with only {len(stream)} samples; the"
        " longest "
    )
    text += (
        f"stretch without a hole of {hole_s} s is kept, {len(kept)} samples. Check the"
        " clock, "
    )
    warnings.append(f"{stream.name}: {text}or split the log")
    return kept


def _merged(stream: Stream) -> tuple[Stream, int, int]:
    """Merge rows of equal stamp; returns duplicates and those of them that hold other values."""
    repeats = np.diff(stream.stamp_ns) == 0
    if not repeats.any():
        return stream, 0, 0
    group = np.concatenate([[0], np.cumsum(~repeats)])
    stamps: Stamps = stream.stamp_ns[np.concatenate([[True], ~repeats])]
    channels: dict[str, Array] = {}
    for name, values in stream.channels.items():
        channels[name] = np.full((len(stamps), values.shape[1]), np.nan)
        # so that the first counts
        rows, columns = np.argwhere(np.isfinite(values))[::-1].T
        channels[name][group[rows], columns] = values[rows, columns]
    lead = next(iter(stream.channels))
    given = np.isfinite(stream.channels[lead])
    surplus = given.sum(axis=0) - np.isfinite(channels[lead]).sum(axis=0)
    other = np.any(given & (stream.channels[lead] != channels[lead][group]), axis=1)
    merged = replace(stream, stamp_ns=stamps, channels=channels)
    return merged, int(surplus.max(initial=0)), int(np.count_nonzero(other))
