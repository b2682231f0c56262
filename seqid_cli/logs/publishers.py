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
        A note on a second publisher is added to it.

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
    warnings.append(
        f"{stream.name}: a second publisher: {count} of {len(stream)} messages"
        f" ({strangers.marks}) contradict the positions of the others and are left out"
    )
    return stream.take(~strangers.rows)


def second_publisher(stream: Stream, where: str) -> Strangers | None:
    """Find the messages of a second publisher; None where there is one publisher.

    Raises InputError where both publishers look like the robot.
    """
    position = stream.channels["position"]
    is_logged = np.isfinite(position).any(axis=0)
    # Messages with all joints: those of a gripper alone are another matter.
    complete: Mask = np.asarray(np.isfinite(position[:, is_logged]).all(axis=1))
    if np.count_nonzero(complete) < 4 * FEWEST or not is_logged.any():
        return None

    # Each way to tell two publishers apart is tried, the surest first.
    effort = _effort(stream)
    silent: Mask = np.asarray(complete & ~np.isfinite(effort).any(axis=1))
    if _contradicts(stream, complete & ~silent, silent):
        marks = ", ".join([*_posture(position[silent]), "no effort"])
        return Strangers(rows=silent, marks=marks)

    q = position[complete][:, is_logged]
    if not _takes_turns(q):
        return None
    idle: Mask = np.zeros(len(stream), dtype=np.bool_)
    if effort.shape[1]:
        idle = complete & _constant(effort, complete)
    constant: Mask = complete & _constant(position, complete)
    on_other_track: Mask = np.zeros(len(stream), dtype=np.bool_)
    on_other_track[complete] = _other_track(q)
    for rows in (idle, constant, on_other_track):
        # Without the stranger's messages one smooth motion must remain.
        remaining = complete & ~rows
        remaining_q = position[remaining][:, is_logged]
        is_one_motion = len(remaining_q) > 2 and not _takes_turns(remaining_q)
        if is_one_motion and _contradicts(stream, remaining, rows):
            return _strangers(stream, remaining, rows, where)
    return None


def _effort(stream: Stream) -> Array:
    """Return all torques and currents of a stream side by side (M, k), k may be 0."""
    efforts = [
        stream.channels[name]
        for name in ("torque", "current")
        if name in stream.channels
    ]
    return np.hstack([np.zeros((len(stream), 0)), *efforts])


def _strangers(stream: Stream, first: Mask, second: Mask, where: str) -> Strangers:
    """Decide which of two publishers is the robot: whose effort, or position, varies.

    Parameters
    ----------
    first, second : ndarray of bool, (M,)
        The messages of both.
    where : str
        The log, for the InputError where neither or both vary.
    """
    position = stream.channels["position"]
    effort = _effort(stream)
    for values in (effort, position):
        first_varies = _varies(values[first])
        if first_varies == _varies(values[second]):
            continue
        strangers = second if first_varies else first
        marks = _posture(position[strangers])
        if values is effort:
            marks.append("an effort that never changes")
        return Strangers(
            rows=strangers, marks=", ".join(marks) or "positions of their own"
        )

    n_first = int(np.count_nonzero(first))
    n_second = int(np.count_nonzero(second))
    raise InputError(
        f"{stream.name}: two publishers take turns, with {n_first} and {n_second}"
        " messages whose positions contradict each other; which of them is the robot"
        " cannot be told",
        hint=REMEDY,
        where=where,
    )


def _varies(values: Array) -> bool:
    """Tell whether any column (M, k) takes more than one value."""
    logged = values[:, np.isfinite(values).any(axis=0)]
    if not logged.size:
        return False
    return bool((np.nanmax(logged, axis=0) > np.nanmin(logged, axis=0)).any())


def _posture(position: Array) -> list[str]:
    """Describe where a publisher's positions (M, n) stand, if they never change."""
    if _varies(position):
        return []
    if np.nan_to_num(position).any():
        return ["positions constant"]
    return ["positions all zero"]


def _contradicts(
    stream: Stream,
    first: Mask,
    second: Mask,
    *,
    min_share: float = 0.1,
    steps: float = 3.0,
    range_share: float = 0.01,
) -> bool:
    """Tell whether positions of some messages cannot be of the motion that others show.

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
    start_ns = stream.stamp_ns[0]
    order = np.argsort(stream.stamp_ns[first], kind="stable")
    t = (stream.stamp_ns[first][order] - start_ns) * 1e-9
    t_second = (stream.stamp_ns[second] - start_ns) * 1e-9
    is_inside = (t_second >= t[0]) & (t_second <= t[-1])
    row = np.clip(np.searchsorted(t, t_second), 1, len(t) - 1)

    is_off = np.zeros(len(t_second), dtype=np.bool_)
    for column in stream.channels["position"].T:
        q = column[first][order]
        if not np.isfinite(q).all():
            continue
        step = np.abs(q[row] - q[row - 1])
        allowed = steps * step + range_share * float(np.ptp(q))
        is_off |= np.abs(column[second] - np.interp(t_second, t, q)) > allowed
    n_off = int(np.count_nonzero(is_off & is_inside))
    return n_off >= max(FEWEST, min_share * len(t_second))


def _takes_turns(
    position: Array, *, far: float = 10.0, far_steps: float = 3.0, least: float = 1e-3
) -> bool:
    """Tell whether positions (M, n) go to and fro by more than they move around it.

    Parameters
    ----------
    far : float
        Times the changes around it, from which a change is no motion. Of these the
        smallest counts: of the message before, of the one behind, and of the next but
        one, which is small where two publishers alternate.
    far_steps : float
        Steps of the encoder that a change must have as well: a slow joint rests from
        one step to the next.
    least : float
        Change that is looked at, rad (m).
    """
    change = np.abs(np.diff(position, axis=0))
    change_over_two = np.abs(position[2:] - position[:-2])
    largest = change.max(axis=1)
    over_two = change_over_two.max(axis=1)
    around = np.minimum(largest[:-2], largest[2:])
    around = np.minimum(around, np.minimum(over_two[:-1], over_two[1:]))

    far_changes = np.flatnonzero(largest[1:-1] > np.maximum(least, far * around))
    if len(far_changes) < 2 * FEWEST:  # most logs end here: their steps are sorted
        return False
    limits = np.maximum(least, far_steps * _encoder_steps(position))
    is_far = (change[1 + far_changes] > limits).any(axis=1)
    return int(np.count_nonzero(is_far)) >= 2 * FEWEST


def _encoder_steps(position: Array) -> Array:
    """Return the smallest step (n,) between the values of each joint's positions.

    It is 0 where a joint takes so few of them that they may be those of two publishers,
    and each of these stands still.
    """
    steps = np.zeros(position.shape[1])
    for j, values in enumerate(position.T):
        taken = np.unique(values)
        if len(taken) >= FEWEST:
            steps[j] = np.diff(taken).min()
    return steps


def _constant(values: Array, rows: Mask) -> Mask:
    """Find the messages (M,) with the values most frequent beside large changes.

    Parameters
    ----------
    values : ndarray, (M, k)
        Efforts or positions, of which one publisher may always send the same.
    rows : ndarray of bool, (M,)
        Messages that count.
    """
    values = np.nan_to_num(values)
    counted = np.flatnonzero(rows)
    change = np.abs(np.diff(values[counted], axis=0)).max(axis=1)
    large = np.flatnonzero(change >= 0.5 * np.quantile(change, 0.99))
    beside = values[counted[np.unique(np.concatenate([large, large + 1]))]]
    return np.asarray((values == _most_frequent(beside)).all(axis=1))


def _most_frequent(rows: Array) -> Array:
    """Return the most frequent of rows (M, k).

    Of several that are as frequent it is the lowest. Rows are compared where their
    first value comes again: to sort whole rows takes most of the time, and few of a
    signal with noise are the same.
    """
    _, which, times = np.unique(rows[:, 0], return_inverse=True, return_counts=True)
    again = rows[times[which] > 1]
    if len(again):
        candidates, counts = np.unique(again, axis=0, return_counts=True)
        if counts.max() > 1:
            return np.asarray(candidates[np.argmax(counts)])
    lowest = rows[which == 0]  # no row comes twice
    return np.asarray(np.unique(lowest, axis=0)[0])


def _other_track(position: Array, *, near: float = 0.2) -> Mask:
    """Part positions (M, n) into two motions that take turns; true (M,) for the rarer.

    Each message goes on with the motion that it is nearer to, forwards and backwards
    from the largest change. Two motions are there only where changes from one to the
    other are large: `near` is the share of them that nine in ten changes within a
    motion must stay below.
    """
    none: Mask = np.zeros(len(position), dtype=np.bool_)
    change = np.abs(np.diff(position, axis=0)).max(axis=1)
    begin = int(np.argmax(change)) + 1
    on_second = none.copy()
    on_second[begin] = True
    first = position[begin - 1]
    second = position[begin]

    forward = _followed(position[begin + 1 :], latest=(first, second), motion=1)
    on_second[begin + 1 :] = forward.on_second
    backward = _followed(position[: begin - 1][::-1], latest=(first, second), motion=0)
    on_second[: begin - 1] = backward.on_second[::-1]
    within = np.concatenate([forward.within, backward.within])
    between = np.concatenate([forward.between, backward.between])

    if len(between) < 2 * FEWEST:
        return none
    if np.quantile(within, 0.9) > near * float(np.median(between)):
        return none
    is_rarer = np.count_nonzero(on_second) <= len(on_second) // 2
    return on_second if is_rarer else ~on_second


@dataclass(frozen=True, kw_only=True)
class _Followed:
    """Messages (M,) of two motions: which are of the second, and changes of position.

    `within` are changes to the latest message of the same motion, `between` those to
    the latest of the other, where messages change from one to the other.
    """

    on_second: Mask
    within: Array
    between: Array


def _followed(
    position: Array, *, latest: tuple[Array, Array], motion: int
) -> _Followed:
    """Assign messages to the motion that each is nearer to.

    Parameters
    ----------
    position : (M, n) array
        Positions in the order in which they are followed.
    latest : tuple of two (n,) arrays
        Latest position of either motion.
    motion : int
        Motion of the message before the first, 0 or 1.
    """
    count = len(position)
    on_second: Mask = np.zeros(count, dtype=np.bool_)
    if not count:
        return _Followed(on_second=on_second, within=np.zeros(0), between=np.zeros(0))
    before = np.vstack([latest[motion], position[:-1]])
    change = np.abs(position - before).max(axis=1)
    positions = list(latest)
    within: list[Array] = []
    between: list[float] = []
    start = 0
    while start < count:
        # The other motion stands still while messages go on with this one, so that a
        # whole run of them is looked at at once.
        other = positions[1 - motion]
        turn = _first_nearer(
            position, change, other, start=start, is_second=motion == 1
        )
        on_second[start:turn] = motion == 1
        within.append(change[start:turn])
        if turn == count:
            break
        if turn > start:
            positions[motion] = position[turn - 1]
        between.append(float(change[turn]))
        within.append(np.abs(position[turn] - other).max(keepdims=True))
        motion = 1 - motion
        positions[motion] = position[turn]
        on_second[turn] = motion == 1
        start = turn + 1
    return _Followed(
        on_second=on_second, within=np.concatenate(within), between=np.array(between)
    )


def _first_nearer(
    position: Array, change: Array, other: Array, *, start: int, is_second: bool
) -> int:
    """Return the first message from `start` on that is nearer to the other motion.

    Of equal distances the first motion has it. Blocks grow, as most runs are short or
    last to the end.
    """
    size = 64
    while start < len(position):
        stop = min(start + size, len(position))
        distance = np.abs(position[start:stop] - other).max(axis=1)
        if is_second:
            is_nearer = distance <= change[start:stop]
        else:
            is_nearer = distance < change[start:stop]
        if is_nearer.any():
            return start + int(np.argmax(is_nearer))
        start = stop
        size *= 2
    return len(position)
