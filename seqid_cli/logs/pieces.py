"""Pieces of a log, each a recording of its own: with the stamps that it has in the log.

A log that is held is cut; one that is too long for that is passed over once more, and
only the rows of the pieces stay.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.long import READERS, LongLog, likely_rows
from seqid_cli.logs.raw import RawLog, Stream, TimeSource, joined
from seqid_cli.logs.read import assemble, read_both
from seqid_cli.logs.recording import Recording, Whole
from seqid_cli.logs.storage.files import check_log, sha256_of, storage_file, unchanged
from seqid_cli.robot.types import Robot

Range = tuple[float, float]  # s since the log's first sample
Sound = Callable[[Recording, RawLog], Recording]
Failed = Callable[[InputError, Stream], None]  # given the joint samples as well


def whole_of(log: Recording | LongLog) -> Whole:
    """Return what a piece needs to know of the log that it is of."""
    if isinstance(log, LongLog):
        length_s = (log.samples - 1) * log.step_s
        return Whole(log.sha256, log.start_ns * 1e-9, length_s)
    if log.source_log is not None:
        return log.source_log
    return Whole(log.sha256, log.start, float(log.t[-1]))


def by_log(recordings: Iterable[Recording]) -> list[list[Recording]]:
    """Group the pieces of each log, logs in the order of their first pieces."""
    logs: dict[object, list[Recording]] = {}
    for number, recording in enumerate(recordings):
        # Two whole logs are two logs even where their content is the same.
        key: object = number
        if recording.source_log is not None:
            whole = recording.source_log
            key = (str(recording.path), whole.sha256, whole.start)
        logs.setdefault(key, []).append(recording)
    return list(logs.values())


def cut(recording: Recording, ranges: Sequence[Range]) -> list[Recording]:
    """Cut pieces out of a recording.

    Parameters
    ----------
    ranges : sequence of (float, float)
        First and last moment of each piece [s since the recording's first sample]; they
        may overlap.

    Returns
    -------
    list of Recording
        `t` begins at 0 in each, `start` is where it begins in the log. Warnings stay
        with the log.
    """
    whole = whole_of(recording)
    pieces = []
    for begin_s, end_s in ranges:
        # Moments are rounded where they were computed: give or take a nanosecond.
        first = int(np.searchsorted(recording.t, begin_s - 1e-9))
        stop = int(np.searchsorted(recording.t, end_s + 1e-9))
        fields = _samples_of(recording, slice(first, stop))
        offset_s = float(fields["t"][0])
        fields["t"] = fields["t"] - offset_s
        fields["start"] = recording.start + offset_s
        pieces.append(_piece(replace(recording, **fields), whole))
    return pieces


def _samples_of(recording: Recording, rows: slice) -> dict[str, Any]:
    """Copy some rows of all fields of a recording that hold samples, by field."""
    fields: dict[str, Any] = {}
    for name, values in vars(recording).items():
        if isinstance(values, np.ndarray):
            fields[name] = values[rows].copy()
        elif isinstance(values, dict):  # readings by IMU
            fields[name] = {imu: array[rows].copy() for imu, array in values.items()}
    return fields


def _piece(recording: Recording, whole: Whole) -> Recording:
    """Make a recording a piece of a log, with a digest of its own."""
    place = f"{whole.sha256} {recording.start - whole.start:.9f} {len(recording.t)}"
    return replace(
        recording,
        sha256=hashlib.sha256(place.encode()).hexdigest(),
        health=replace(recording.health, gaps=(), warnings=()),
        source_log=whole,
    )


def read_pieces(
    path: Path,
    robot: Robot,
    whole: Whole,
    ranges: Sequence[Range],
    *,
    time_source: TimeSource = "header",
    kind: str = "",
    sound: Sound | None = None,
) -> list[Recording]:
    """Read pieces of a log without holding the rest of it.

    Parameters
    ----------
    whole : Whole
        The log, as its first reading found it.
    ranges : sequence of (float, float)
        As of `cut`; they may overlap.
    kind : str
        The format of a log that can be passed over; a log of any other is read as a
        whole and cut.
    sound : callable, optional
        Takes damaged samples out of what `read_both` gives.

    Raises
    ------
    InputError
        The file cannot be read, or holds too little of a piece.
    """
    if kind not in READERS:
        recording, raw = read_both(path, robot, time_source=time_source)
        if sound is not None:
            recording = sound(recording, raw)
        return cut(recording, ranges)

    # One pass; each piece gathers its rows, block by block.
    spans_ns = [
        (int((whole.start + begin_s) * 1e9), int((whole.start + end_s) * 1e9))
        for begin_s, end_s in ranges
    ]
    parts_by_piece: list[list[RawLog]] = [[] for _ in ranges]
    try:
        for block in READERS[kind](path, robot, time_source):
            for (first_ns, last_ns), parts in zip(
                spans_ns, parts_by_piece, strict=True
            ):
                part = _within(block, first_ns, last_ns)
                if _n_values(part):
                    parts.append(part)
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error

    pieces = []
    for (begin_s, _), parts in zip(ranges, parts_by_piece, strict=True):
        if not any(len(part.joints) for part in parts):
            raise InputError(
                f"no longer holds the rows {begin_s:.3g} s on", where=str(path)
            )
        recording, raw = assemble(
            path, kind, whole.sha256, _joined_blocks(parts), robot
        )
        if sound is not None:
            recording = sound(recording, raw)
        pieces.append(_piece(recording, whole))
    return pieces


def _within(
    raw: RawLog, first_ns: int, last_ns: int, *, around_s: float = 0.1
) -> RawLog:
    """Select what lies between two stamps, without what was said of the whole.

    IMUs have stamps of their own: of them a little more is taken, so that they cover
    the joints' time.
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
    return replace(raw, joints=joints, imus=imus, warnings=(), partial="")


def _between(stream: Stream, first_ns: int, last_ns: int) -> Stream:
    stamps = stream.stamp_ns
    if not len(stamps) or stamps[0] > last_ns or stamps[-1] < first_ns:
        return stream.take(np.zeros(0, np.intp))  # no view, which would hold them all
    return stream.take((stamps >= first_ns) & (stamps <= last_ns))


def read_parts(
    path: Path,
    robot: Robot,
    *,
    time_source: TimeSource = "header",
    most_values: int = 4_000_000,
    overlap_s: float = 1.0,
    failed: Failed | None = None,
) -> Iterator[tuple[Recording, RawLog]]:
    """Read a log part by part, in memory that does not grow with its length.

    Parameters
    ----------
    most_values : int
        Samples times channels of a part, about; a log of fewer is one part.
    overlap_s : float
        Time at the end of a part that the next one begins with, so that nothing falls
        between them [s].
    failed : callable, optional
        Told of a part that is of no use, instead of an InputError as of `read_both`.

    Yields
    ------
    Recording, RawLog
        A part, and what was logged in it; as `read_both` returns them of a log.
    """
    kind = check_log(path)
    file = storage_file(path)
    n_channels = 3 * robot.n
    for imu in robot.imus:
        n_channels += len(imu.positions) + 3 * imu.gyro
    if kind not in READERS or likely_rows(path) * n_channels <= most_values:
        yield read_both(path, robot, time_source=time_source)
        return

    with unchanged(file):
        digest = sha256_of(file)
        blocks = READERS[kind](file, robot, time_source)
        for raw in _parts(blocks, most_values, int(overlap_s * 1e9)):
            try:
                part = assemble(path, kind, digest, raw, robot)
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
    warnings = dict.fromkeys(text for block in blocks for text in block.warnings)
    return replace(
        blocks[-1],
        joints=joined([block.joints for block in blocks]),
        imus=imus,
        warnings=tuple(warnings),
    )
