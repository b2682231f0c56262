"""What the drives were asked for, on the time base of a log.

Commands come in one of three forms, which a recording keeps, for it decides what is
between two of them:

- "sent": they have stamps of their own, in messages or in some rows only. A command
  holds until the next one, and `age` tells when it was sent.
- "held": each row has one, but most repeat that of the row before: the commands come
  slower than the rows. A command holds until it changes.
- "sampled": each row has a new one. What was between the rows is not known.

A curve is laid through positions, but never through commands: they step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.logs.raw import Stream
from seqid_cli.logs.recording import CommandForm
from seqid_cli.logs.tables.name_words import COMMANDS
from seqid_cli.logs.timebase import UNIFORM, Base
from seqid_cli.typing import Array, Mask

# Share of the rows that hold commands; fewer are rows of a slower logger, put between
# those of a faster one.
FILLED = 0.9
# Of the distances between changes, in rows, this quantile tells how fast commands can
# come: coarse commands of a slow motion repeat as well, those of a fast one do not.
FASTEST = 0.1
# Steps of a command that goes on: larger than so many of its smallest, which may be one
# of rounding; at least so many; and the share of them behind a repeated row, from which
# on commands are slower than rows.
COARSE = 3.0
FEWEST_STEPS = 20
REPEATED = 0.1


@dataclass(frozen=True, kw_only=True)
class Commands:
    """Commands on the time base, and how they were logged."""

    # (N, n) by quantity; NaN where a joint has none, or not yet
    values: dict[str, Array] = field(default_factory=dict)
    form: CommandForm = ""
    age: Array | None = None  # (N,) s since they were sent, where they have stamps


NO_COMMANDS = Commands()


def commands_on_base(rows: Stream, messages: Sequence[Stream], base: Base) -> Commands:
    """Bring commands to the time base.

    Parameters
    ----------
    rows : Stream
        Joint samples in the order of time, which may hold commands as well.
    messages : sequence of Stream
        Commands with stamps of their own. They count more than those of the rows.
    base : Base
        N samples.
    """
    streams = [
        stream.take(np.argsort(stream.stamp_ns, kind="stable")) for stream in messages
    ]
    streams = [stream for stream in streams if _filled(stream).any()]
    if not streams:
        is_filled = _filled(rows)
        if not is_filled.any():
            return NO_COMMANDS
        if is_filled.mean() >= FILLED:
            return _of_rows(rows, base)
        streams = [_commands_only(rows).take(is_filled)]
    return _sent(streams, base)


def latest_of_samples(
    rows: Stream, messages: Sequence[Stream], quantity: str
) -> Array | None:
    """Return what each joint was asked for by the time of each sample.

    Parameters
    ----------
    rows : Stream
        M joint samples, which may hold commands as well.
    messages : sequence of Stream
        Commands with stamps of their own. They count more than those of the rows.
    quantity : str
        One of `COMMANDS`.

    Returns
    -------
    (M, n) array or None
        NaN where a joint has no command, or not yet; None where no joint has any.
    """
    sources = [stream for stream in messages if quantity in stream.channels]
    if not sources:
        return rows.channels.get(quantity)
    columns = []
    for joint in _joints(sources):
        stream = _fullest(sources, quantity, joint)
        given = stream.channels[quantity][:, joint]
        present = np.flatnonzero(np.isfinite(given))
        present = present[np.argsort(stream.stamp_ns[present], kind="stable")]
        column = np.full(len(rows), np.nan)
        if len(present):
            stamps = stream.stamp_ns[present]
            latest = np.searchsorted(stamps, rows.stamp_ns, side="right") - 1
            column = np.where(latest >= 0, given[present[latest]], np.nan)
        columns.append(column)
    return np.column_stack(columns)


def _filled(stream: Stream) -> Mask:
    """Return the samples (M,) that hold any command."""
    filled: Mask = np.zeros(len(stream), np.bool_)
    for quantity in COMMANDS:
        if quantity in stream.channels:
            filled |= np.isfinite(stream.channels[quantity]).any(axis=1)
    return filled


def _commands_only(stream: Stream) -> Stream:
    """Return a stream without its other channels."""
    channels = {
        name: stream.channels[name] for name in COMMANDS if name in stream.channels
    }
    return replace(stream, channels=channels)


def _of_rows(rows: Stream, base: Base) -> Commands:
    """Bring commands of the rows to the base: held or along straight lines."""
    channels = _commands_only(rows).channels
    held = any(is_held(values) for values in channels.values())
    on_base: dict[str, Array] = {}
    for quantity, values in channels.items():
        if not _any(values):
            continue
        if base.exact and len(rows) == base.count:
            on_base[quantity] = values.copy()
        elif held:
            on_base[quantity] = _held_values(_seconds(rows, base), values, base)
        else:
            on_base[quantity] = _along_lines(_seconds(rows, base), values, base)
    return Commands(values=on_base, form="held" if held else "sampled")


def is_held(values: Array) -> bool:
    """Tell whether commands (M, n) come slower than the rows that hold them."""
    return any(
        held_period(column[np.isfinite(column)]) is not None for column in values.T
    )


def held_period(command: Array) -> float | None:
    """Return the rows between two changes of a command (M,); None if none are.

    Commands may come every 1.6 rows: then some rows repeat the one before, though the
    command goes on in one direction by steps that are not the smallest it has.
    """
    steps = np.diff(command)
    changes = np.flatnonzero(steps)
    if len(changes) < 2:
        return None
    gaps = np.diff(changes)
    if np.quantile(gaps, FASTEST) >= 2.0:
        return float(np.median(gaps))

    sizes = np.abs(steps[changes])
    coarse = COARSE * sizes.min()
    goes_on = (steps[changes[1:]] * steps[changes[:-1]] > 0.0) & (
        np.minimum(sizes[1:], sizes[:-1]) > coarse
    )
    if np.count_nonzero(goes_on) < FEWEST_STEPS:
        return None
    if np.mean(gaps[goes_on] > 1) < REPEATED:
        return None
    return float(np.mean(gaps[goes_on]))


def _sent(streams: Sequence[Stream], base: Base) -> Commands:
    """Hold commands with stamps of their own until the next one."""
    on_base: dict[str, Array] = {}
    for quantity in COMMANDS:
        sources = [stream for stream in streams if quantity in stream.channels]
        if not sources:
            continue
        values = np.column_stack(
            [
                _fullest_on_base(sources, quantity, joint, base)
                for joint in _joints(sources)
            ]
        )
        if _any(values):
            on_base[quantity] = values

    stamps = np.unique(
        np.concatenate([stream.stamp_ns[_filled(stream)] for stream in streams])
    )
    seconds = (stamps - base.start_ns) * 1e-9
    sent_at = _held_values(seconds, seconds[:, None], base)[:, 0]
    return Commands(values=on_base, form="sent", age=base.t - sent_at)


def _joints(streams: Sequence[Stream]) -> range:
    """Return the numbers of the joints."""
    channels = streams[0].channels
    return range(next(iter(channels.values())).shape[1])


def _fullest(streams: Sequence[Stream], quantity: str, joint: int) -> Stream:
    """Return the stream that has most commands of a joint."""
    return max(
        streams,
        key=lambda each: np.count_nonzero(
            np.isfinite(each.channels[quantity][:, joint])
        ),
    )


def _fullest_on_base(
    streams: Sequence[Stream], quantity: str, joint: int, base: Base
) -> Array:
    """Return a joint's command (N,) from the stream that has most of them."""
    stream = _fullest(streams, quantity, joint)
    column = stream.channels[quantity][:, joint : joint + 1]
    return _held_values(_seconds(stream, base), column, base)[:, 0]


def _seconds(stream: Stream, base: Base) -> Array:
    """Return the stamps of a stream (M,) in s since the start of the base."""
    return (stream.stamp_ns - base.start_ns).astype(np.float64) * 1e-9


def _held_values(seconds: Array, values: Array, base: Base) -> Array:
    """Return at each base sample the last of the values (M, w) by then, NaN before."""
    # Stamps that lie on the base are rounded: a value counts from its own sample on.
    t = base.t + UNIFORM * base.step_s
    held = np.full((base.count, values.shape[1]), np.nan)
    for column, given in enumerate(values.T):
        present = np.isfinite(given)
        if not present.any():
            continue
        latest = np.searchsorted(seconds[present], t, side="right") - 1
        held[:, column] = np.where(latest >= 0, given[present][latest], np.nan)
    return held


def _along_lines(seconds: Array, values: Array, base: Base) -> Array:
    """Return values (M, w) on straight lines between them, NaN outside."""
    out = np.full((base.count, values.shape[1]), np.nan)
    slack = UNIFORM * base.step_s
    for column, given in enumerate(values.T):
        present = np.isfinite(given)
        if not present.any():
            continue
        x = seconds[present]
        inside = (base.t >= x[0] - slack) & (base.t <= x[-1] + slack)
        line = np.interp(base.t, x, given[present])
        out[:, column] = np.where(inside, line, np.nan)
    return out


def _any(values: Array) -> bool:
    return bool(np.isfinite(values).any())
