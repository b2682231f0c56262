"""Two publishers on one topic: the messages of one are left out, or the log is refused.

A simulator's or a launch file's `joint_state_publisher` beside the robot's own driver
gives a log in which two motions take turns. Nothing in a message says who sent it. It
shows in what they hold: one sends no effort, or always the same positions, or goes
another way. Messages count as another publisher's only where the positions of the rest
contradict them, so a joint that rests, or a driver that sends its effort less often
than its position, is one publisher.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Stream
from seqid_cli.typing import Array, Mask

FEWEST = 5  # messages that make a publisher; fewer are spikes
REMEDY = "Let one node publish on the topic, or remap the other, and record again."


@dataclass(frozen=True, kw_only=True)
class Strangers:
    """Messages (M,) of another publisher, and what marks them."""

    rows: Mask
    marks: str


def without_second_publisher(stream: Stream, where: str, warnings: list[str]) -> Stream:
    """Leave the messages of a second publisher out of a joint stream, and say so.

    Parameters
    ----------
    stream : Stream
        Joint samples in the order in which they were logged.
    where : str
        The log, for messages.
    warnings : list of str
        What is to be said is added to it.

    Returns
    -------
    Stream
        The same stream where there is one publisher.

    Raises
    ------
    InputError
        Both publishers look like the robot.
    """
    strangers = second_publisher(stream, where)
    if strangers is None:
        return stream
    count = int(np.count_nonzero(strangers.rows))
    text = (
        f"a second publisher: {count} of {len(stream)} messages ({strangers.marks})"
        " contradict "
    )
    warnings.append(
        f"{stream.name}: {text}the positions of the others and are left out"
    )
    return stream.take(~strangers.rows)


def second_publisher(stream: Stream, where: str) -> Strangers | None:
    """Return the messages of a second publisher; see `without_second_publisher`."""
    position = stream.channels["position"]
    logged = np.isfinite(position).any(axis=0)
    whole: Mask = np.asarray(np.isfinite(position[:, logged]).all(axis=1))
    if np.count_nonzero(whole) < 4 * FEWEST or not logged.any():
        return None
    # Each way to tell two publishers apart is tried, the surest first.
    effort = _effort(stream)
    silent: Mask = np.asarray(whole & ~np.isfinite(effort).any(axis=1))
    if _contradicts(stream, whole & ~silent, silent):
        return Strangers(
            rows=silent, marks=", ".join([*_posture(position[silent]), "no effort"])
        )
    if not _takes_turns(position[whole][:, logged]):
        return None
    idle: Mask = np.zeros(len(stream), dtype=np.bool_)
    if effort.shape[1]:
        idle = whole & _constant(effort, whole)
    constant: Mask = whole & _constant(position, whole)
    tracked: Mask = np.zeros(len(stream), dtype=np.bool_)
    tracked[whole] = _other_track(position[whole][:, logged])
    for rows in (idle, constant, tracked):
        rest = position[whole & ~rows][:, logged]
        alone = len(rest) > 2 and not _takes_turns(rest)
        if alone and _contradicts(stream, whole & ~rows, rows):
            return _strangers(stream, whole, rows, where)
    return None


def _effort(stream: Stream) -> Array:
    """Return all torques and currents of a stream side by side (M, k), k may be 0."""
    given = [stream.channels[k] for k in ("torque", "current") if k in stream.channels]
    return np.hstack([np.zeros((len(stream), 0)), *given])


def _strangers(stream: Stream, whole: Mask, rows: Mask, where: str) -> Strangers:
    """Decide which of two publishers is the robot: the one whose effort, or position, varies."""
    position, effort = stream.channels["position"], _effort(stream)
    first, second = whole & ~rows, rows
    for values in (effort, position):
        varies = [_varies(values[own]) for own in (first, second)]
        if varies[0] != varies[1]:
            others = second if varies[0] else first
            marks = _posture(position[others])
            if values is effort:
                marks.append("an effort that never changes")
            text = ", ".join(marks) or "positions of their own"
            return Strangers(rows=others, marks=text)
    counts = [int(np.count_nonzero(own)) for own in (first, second)]
    message = (
        f"{stream.name}: two publishers take turns, with {counts[0]} and {counts[1]}"
        " messages whose positions contradict each other; which of them is the robot"
        " cannot be told"
    )
    raise InputError(message, hint=REMEDY, where=where)


def _varies(values: Array) -> bool:
    """Tell whether any column (M, k) takes more than one value."""
    finite = values[:, np.isfinite(values).any(axis=0)]
    if not finite.size:
        return False
    return bool((np.nanmax(finite, axis=0) > np.nanmin(finite, axis=0)).any())


def _posture(position: Array) -> list[str]:
    """Say where a publisher's positions (M, n) stand, if they never change."""
    if _varies(position):
        return []
    return [
        (
            "positions all zero"
            if not np.nan_to_num(position).any()
            else "positions constant"
        )
    ]


def _contradicts(
    stream: Stream,
    first: Mask,
    second: Mask,
    *,
    min_share: float = 0.1,
    steps: float = 3.0,
    range_share: float = 0.01,
) -> bool:
    """Tell whether the positions of some messages cannot be of the motion that others show.

    Parameters
    ----------
    stream : Stream
        Joint samples.
    first, second : ndarray of bool, (M,)
        Messages whose motion counts, and those that are held against it.
    min_share : float
        Share of the second's messages that must contradict; the others may meet the
        motion.
    steps : float
        Steps of the motion between two messages that a position may be off, as stamps
        are.
    range_share : float
        Share of a joint's range of motion that it may be off besides.
    """
    if min(np.count_nonzero(first), np.count_nonzero(second)) < FEWEST:
        return False
    order = np.argsort(stream.stamp_ns[first], kind="stable")
    t = (stream.stamp_ns[first][order] - stream.stamp_ns[0]) * 1e-9
    at = (stream.stamp_ns[second] - stream.stamp_ns[0]) * 1e-9
    inside = (at >= t[0]) & (at <= t[-1])
    behind = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    off = np.zeros(len(at), dtype=np.bool_)
    for column in stream.channels["position"].T:
        q = column[first][order]
        if not np.isfinite(q).all():
            continue
        step = np.abs(q[behind] - q[behind - 1])
        allowed = steps * step + range_share * float(np.ptp(q))
        off |= np.abs(column[second] - np.interp(at, t, q)) > allowed
    count = int(np.count_nonzero(off & inside))
    return count >= max(FEWEST, min_share * len(at))


def _takes_turns(position: Array, *, far: float = 10.0, least: float = 1e-3) -> bool:
    """Tell whether positions (M, n) go to and fro by more than they move otherwise.

    `far`: times the usual change from one message to the next or the next but one, of
    which two publishers that alternate leave the second small. `least`: change, rad
    (m), that is looked at.
    """
    one, two = (np.abs(position[k:] - position[:-k]).max(axis=1) for k in (1, 2))
    usual = min(float(np.median(one)), float(np.median(two)))
    return int(np.count_nonzero(one > max(far * usual, least))) >= 2 * FEWEST


def _constant(given: Array, whole: Mask) -> Mask:
    """Where (M,) values (M, k) are the very same as most often next to a large change."""
    values = np.nan_to_num(given)
    rows = np.flatnonzero(whole)
    size = np.abs(np.diff(values[rows], axis=0)).max(axis=1)
    large = np.flatnonzero(size >= 0.5 * np.quantile(size, 0.99))
    beside = values[rows[np.unique(np.concatenate([large, large + 1]))]]
    different, counts = np.unique(beside, axis=0, return_counts=True)
    return np.asarray((values == different[np.argmax(counts)]).all(axis=1))


def _other_track(position: Array, *, near: float = 0.2) -> Mask:
    """Part positions (M, n) into two motions that take turns; true (M,) for the rarer one.

    Each message goes on with the motion that it is nearer to, forwards and backwards
    from the largest change. Two motions are there only where changes from one to the
    other are large: `near` is the share of them that nine in ten changes within a
    motion must stay below.
    """
    size = np.abs(np.diff(position, axis=0)).max(axis=1)
    begin = int(np.argmax(size)) + 1
    other = np.zeros(len(position), dtype=np.bool_)
    other[begin] = True
    within: list[float] = []
    between: list[float] = []
    last_rows = [begin - 1, begin]
    for rows in (range(begin + 1, len(position)), range(begin - 2, -1, -1)):
        last = [position[k] for k in last_rows]
        before = other[rows.start - rows.step] if len(rows) else False
        for k in rows:
            distances = [float(np.abs(position[k] - place).max()) for place in last]
            nearer = int(np.argmin(distances))
            if nearer != before:
                between.append(distances[1 - nearer])
            within.append(distances[nearer])
            last[nearer], other[k], before = position[k], bool(nearer), bool(nearer)
    apart = len(between) >= 2 * FEWEST
    if not apart or np.quantile(within, 0.9) > near * float(np.median(between)):
        return np.zeros(len(position), dtype=np.bool_)
    return other if np.count_nonzero(other) <= len(other) // 2 else ~other
