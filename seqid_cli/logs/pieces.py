"""Pieces of a log, each a recording of its own: with the stamps that it has in the log.

A log that is held is cut; one that is too long for that is passed over once more, and
only the rows of the pieces are kept.
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
    """What a piece tells of the log that it is of."""
    if isinstance(log, LongLog):
        return Whole(log.sha256, log.start_ns * 1e-9, (log.samples - 1) * log.step_s)
    return log.whole or Whole(log.sha256, log.start, float(log.t[-1]))


def by_log(recordings: Iterable[Recording]) -> list[list[Recording]]:
    """Recordings, or the pieces of each log together, in the order of the first of each."""
    logs: dict[object, list[Recording]] = {}
    for number, recording in enumerate(recordings):
        whole = recording.whole
        # Two whole ones are two logs even where their content is the same.
        key = (
            number
            if whole is None
            else (str(recording.path), whole.sha256, whole.start)
        )
        logs.setdefault(key, []).append(recording)
    return list(logs.values())


def cut(recording: Recording, ranges: Sequence[Range]) -> list[Recording]:
    """Cut pieces out of a recording, from first to last moment, s since its first sample.

    `t` begins at 0 in each, `start` is where it begins in the log. Warnings stay with
    the log.
    """
    whole, t = whole_of(recording), recording.t
    pieces = []
    for begin, end in ranges:
        part = slice(
            int(np.searchsorted(t, begin - 1e-9)), int(np.searchsorted(t, end + 1e-9))
        )
        own: dict[str, Any] = {}
        for name, values in vars(recording).items():
            if isinstance(values, np.ndarray):
                own[name] = values[part].copy()
            elif isinstance(values, dict):  # IMUs
                own[name] = {
                    imu: readings[part].copy() for imu, readings in values.items()
                }
        first = float(own["t"][0])
        own |= {"t": own["t"] - first, "start": recording.start + first}
        pieces.append(_piece(replace(recording, **own), whole))
    return pieces


def _piece(found: Recording, whole: Whole) -> Recording:
    """Samples as a piece of a log, with a digest of its own."""
    place = f"{whole.sha256} {found.start - whole.start:.9f} {len(found.t)}"
    digest = hashlib.sha256(place.encode()).hexdigest()
    health = replace(found.health, gaps=(), warnings=())
    return replace(found, sha256=digest, health=health, whole=whole)


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

    `ranges`: as of `cut`; they may overlap. `kind`: the format of a log that can be
    passed over; a log of any other is read as a whole and cut. `sound`: takes damaged
    samples out of what `read_both` gives. Raises InputError: the file cannot be read,
    or holds too little of a piece.
    """
    if kind not in READERS:
        recording, all_rows = read_both(path, robot, time_source=time_source)
        return cut(sound(recording, all_rows) if sound else recording, ranges)
    spans = [[int((whole.start + moment) * 1e9) for moment in one] for one in ranges]
    kept: list[list[RawLog]] = [[] for _ in spans]
    try:
        for raw in READERS[kind](path, robot, time_source):
            for span, own in zip(spans, kept, strict=True):
                own += [part] if _size(part := _within(raw, *span)) else []
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path)) from error
    pieces = []
    for (begin, _), own in zip(ranges, kept, strict=True):
        if not any(len(part.joints) for part in own):
            raise InputError(
                f"no longer holds the rows {begin:.3g} s on", where=str(path)
            )
        found, raw = assemble(path, kind, whole.sha256, _following(own), robot)
        pieces.append(_piece(sound(found, raw) if sound else found, whole))
    return pieces


def _within(raw: RawLog, first: int, last: int, *, around_s: float = 0.1) -> RawLog:
    """What lies between two stamps, of IMUs a little more; without what was said of it."""
    imus, more = {}, int(around_s * 1e9)
    for name, streams in raw.imus.items():
        imus[name] = tuple(
            _between(stream, first - more, last + more) for stream in streams
        )
    joints = _between(raw.joints, first - 1000, last + 1000)
    return replace(raw, joints=joints, imus=imus, warnings=(), partial="")


def _between(stream: Stream, first: int, last: int) -> Stream:
    stamps = stream.stamp_ns
    if not len(stamps) or stamps[0] > last or stamps[-1] < first:
        return stream.take(np.zeros(0, np.intp))  # no view, which would hold them all
    return stream.take((stamps >= first) & (stamps <= last))


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

    `most_values`: samples times channels of a part, about; a log of fewer is one part.
    `overlap_s`: time at the end of a part that the next one begins with, so that
    nothing falls between them. `failed`: told of a part that is of no use, instead of
    an InputError as of `read_both`.
    """
    kind, file = check_log(path), storage_file(path)
    width = 3 * robot.n + sum(len(imu.positions) + 3 * imu.gyro for imu in robot.imus)
    if kind not in READERS or likely_rows(path) * width <= most_values:
        yield read_both(path, robot, time_source=time_source)
        return
    with unchanged(file):
        digest = sha256_of(file)
        blocks = READERS[kind](file, robot, time_source)
        for raw in _parts(blocks, most_values, int(overlap_s * 1e9)):
            try:
                read = assemble(path, kind, digest, raw, robot)
            except InputError as error:
                if failed is None:
                    raise
                failed(error, raw.joints)
                continue
            del raw  # it is large, and the next one comes
            yield read
            del read


def _parts(blocks: Iterable[RawLog], most: int, overlap_ns: int) -> Iterator[RawLog]:
    """Put blocks together to parts of `most` values; the last has half to one and a half."""
    held: list[RawLog] = []
    ready = size = 0  # `ready`: blocks that are enough for a part
    for block in blocks:
        held.append(block)
        size += _size(block)
        ready = ready or (len(held) if size >= most else 0)
        if size >= 1.5 * most and ready < len(held):
            part = _following(held[:ready])
            last = int(part.joints.stamp_ns[-1])
            held = [_within(part, last - overlap_ns, last, around_s=0.0), *held[ready:]]
            ready, size = 0, sum(map(_size, held))
            yield part
            del part
    yield _following(held)


def _size(raw: RawLog) -> int:
    streams = (
        raw.joints,
        *(stream for streams in raw.imus.values() for stream in streams),
    )
    return sum(values.size for stream in streams for values in stream.channels.values())


def _following(blocks: Sequence[RawLog]) -> RawLog:
    """Consecutive blocks as one; IMUs from where all of their streams are there."""
    imus: dict[str, tuple[Stream, ...]] = {}
    for name in dict.fromkeys(name for block in blocks for name in block.imus):
        parts = [block.imus[name] for block in blocks if name in block.imus]
        whole = [part for part in parts if len(part) == max(map(len, parts))]
        imus[name] = tuple(map(joined, zip(*whole, strict=True)))
    return replace(
        blocks[-1],
        joints=joined([block.joints for block in blocks]),
        imus=imus,
        warnings=tuple(
            dict.fromkeys(text for block in blocks for text in block.warnings)
        ),
    )
