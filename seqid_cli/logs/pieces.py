"""Windows of a log with all its channels, out of blocks of what was logged.

Each is assembled to a recording of its own: pieces that somebody has chosen, with the
stamps that they have in the log, or one part after the other. Only the rows of a window
are held.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.log_file import LogFile, running_on
from seqid_cli.logs.raw import RawLog, Stream, joined
from seqid_cli.logs.read import assemble
from seqid_cli.logs.recording import Range, Recording, Whole, piece_of
from seqid_cli.robot.types import Robot

Sound = Callable[[Recording, RawLog], Recording]
Failed = Callable[[InputError, Stream], None]  # given the joint samples as well


def read_pieces(
    log: LogFile,
    robot: Robot,
    whole: Whole,
    ranges: Sequence[Range],
    *,
    sound: Sound | None = None,
) -> list[Recording]:
    """Read pieces of a log in one pass over it, without holding the rest.

    Parameters
    ----------
    log : LogFile
        Of a format that comes in blocks.
    robot : Robot
        Names of joints, channels and IMUs.
    whole : Whole
        The log, as its first reading found it.
    ranges : sequence of (float, float)
        As of `cut`; they may overlap.
    sound : callable, optional
        Takes damaged samples out of what `assemble` gives.

    Raises
    ------
    InputError
        The file cannot be read, or holds too little of a piece.
    """
    spans_ns = [
        (int((whole.start + begin_s) * 1e9), int((whole.start + end_s) * 1e9))
        for begin_s, end_s in ranges
    ]
    parts_by_piece: list[list[RawLog]] = [[] for _ in ranges]
    for block in log.blocks(robot):
        for (first_ns, last_ns), parts in zip(spans_ns, parts_by_piece, strict=True):
            part = _within(block, first_ns, last_ns)
            if _n_values(part):
                parts.append(part)

    pieces = []
    for (begin_s, _), parts in zip(ranges, parts_by_piece, strict=True):
        if not any(len(part.joints) for part in parts):
            raise InputError(
                f"no longer holds the rows {begin_s:.3g} s on", where=str(log.path)
            )
        recording, raw = assemble(
            log.path, log.format, whole.sha256, _joined_blocks(parts), robot
        )
        if sound is not None:
            recording = sound(recording, raw)
        pieces.append(piece_of(recording, whole))
    return pieces


def _within(
    raw: RawLog, first_ns: int, last_ns: int, *, around_s: float = 0.1
) -> RawLog:
    """Select what lies between two stamps, without what was said of the whole.

    IMUs and commands have stamps of their own: of them a little more is taken, so that
    they cover the joints' time.
    """
    around_ns = int(around_s * 1e9)
    imus = {
        name: tuple(
            _between(stream, first_ns - around_ns, last_ns + around_ns)
            for stream in streams
        )
        for name, streams in raw.imus.items()
    }
    # Moments in seconds are rounded: a microsecond on either side.
    joints = _between(raw.joints, first_ns - 1000, last_ns + 1000)
    commands = tuple(
        _between(stream, first_ns - around_ns, last_ns + around_ns)
        for stream in raw.commands
    )
    return replace(
        raw, joints=joints, imus=imus, commands=commands, warnings=(), partial=""
    )


def _between(stream: Stream, first_ns: int, last_ns: int) -> Stream:
    stamps = stream.stamp_ns
    if not len(stamps) or stamps[0] > last_ns or stamps[-1] < first_ns:
        return stream.take(np.zeros(0, np.intp))  # no view, which would hold them all
    return stream.take((stamps >= first_ns) & (stamps <= last_ns))


def read_parts(
    log: LogFile,
    robot: Robot,
    *,
    most_values: int = 4_000_000,
    overlap_s: float = 1.0,
    failed: Failed | None = None,
) -> Iterator[tuple[Recording, RawLog]]:
    """Read a log part by part, in memory that does not grow with its length.

    Parameters
    ----------
    log : LogFile
        One whose format does not come in blocks is a single part.
    robot : Robot
        Names of joints, channels and IMUs.
    most_values : int
        Samples times channels of a part, about; a log of fewer is one part.
    overlap_s : float
        Time at the end of a part that the next one begins with, so that nothing falls
        between them [s].
    failed : callable, optional
        Told of a part that is of no use, one of several, instead of an InputError.

    Yields
    ------
    Recording, RawLog
        A part, and what was logged in it; as `assemble` returns them of a log.
    """
    n_channels = 3 * robot.n
    for imu in robot.imus:
        n_channels += len(imu.positions) + 3 * imu.gyro
    if not log.blockwise or log.likely_rows() * n_channels <= most_values:
        raw = log.whole(robot)
        yield assemble(log.file, log.format, log.sha256, raw, robot)
        return

    digest = log.sha256
    for raw in _parts(log.blocks(robot), most_values, int(overlap_s * 1e9)):
        try:
            part = assemble(log.path, log.format, digest, running_on(raw, robot), robot)
        except InputError as error:
            if failed is None:
                raise
            failed(error, raw.joints)
            continue
        del raw  # it is large, and the next one comes
        yield part
        del part


def _parts(blocks: Iterable[RawLog], most: int, overlap_ns: int) -> Iterator[RawLog]:
    """Put blocks together to parts of `most` values.

    A part is given away when half of another one has come behind it, so that the last
    one has between half and one and a half of `most`.
    """
    pending: list[RawLog] = []
    n_pending = 0  # values
    n_ready = 0  # blocks that are enough for a part, 0 while they are not
    for block in blocks:
        pending.append(block)
        n_pending += _n_values(block)
        if not n_ready and n_pending >= most:
            n_ready = len(pending)
        if n_pending >= 1.5 * most and n_ready < len(pending):
            part = _joined_blocks(pending[:n_ready])
            last_ns = int(part.joints.stamp_ns[-1])
            end = _within(part, last_ns - overlap_ns, last_ns, around_s=0.0)
            pending = [end, *pending[n_ready:]]
            n_pending = sum(map(_n_values, pending))
            n_ready = 0
            yield part
            del part  # it is large, and the next one comes
    yield _joined_blocks(pending)


def _n_values(raw: RawLog) -> int:
    """Count the values of all channels of a log."""
    streams = [raw.joints]
    for imu_streams in raw.imus.values():
        streams += imu_streams
    return sum(values.size for stream in streams for values in stream.channels.values())


def _joined_blocks(blocks: Sequence[RawLog]) -> RawLog:
    """Join consecutive blocks; an IMU from where all of its streams are there."""
    imus: dict[str, tuple[Stream, ...]] = {}
    for name in dict.fromkeys(name for block in blocks for name in block.imus):
        parts = [block.imus[name] for block in blocks if name in block.imus]
        n_streams = max(map(len, parts))
        complete = [part for part in parts if len(part) == n_streams]
        imus[name] = tuple(map(joined, zip(*complete, strict=True)))
    commands: dict[str, list[Stream]] = {}
    for block in blocks:
        for stream in block.commands:
            commands.setdefault(stream.name, []).append(stream)
    warnings = dict.fromkeys(text for block in blocks for text in block.warnings)
    return replace(
        blocks[-1],
        joints=joined([block.joints for block in blocks]),
        imus=imus,
        commands=tuple(map(joined, commands.values())),
        warnings=tuple(warnings),
    )
