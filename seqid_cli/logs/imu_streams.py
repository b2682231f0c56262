"""Streams of IMUs put right: readings that are none, and how often there is one.

Some drivers send acceleration and angular velocity in messages of their own, each with
zeros for the other. No accelerometer reads zero along all axes while the IMU turns, so
such zeros are missing values: the two quantities have half of the messages each.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, Array, Mask, Stream


def without_zeros(
    stream: Stream,
    warnings: list[str],
    *,
    min_share: float = 0.1,
    min_covered: float = 0.9,
    min_turns: float = 0.5,
) -> Stream:
    """Take zeros for missing where messages hold one of both quantities in turns.

    Parameters
    ----------
    stream : Stream
        Readings of an IMU.
    warnings : list of str
        A note on what was taken for missing is added to it.
    min_share : float
        Share of the messages that each quantity has at least.
    min_covered : float
        Share of them in which one of both is zero.
    min_turns : float
        Turns from one to the other, as a share of the rarer one's messages: a gyro that
        rests may read zero for long.
    """
    if not {ACCELEROMETERS, GYRO} <= set(stream.channels) or len(stream) < 2:
        return stream
    no_force = _is_zero(stream.channels[ACCELEROMETERS])
    no_rate = _is_zero(stream.channels[GYRO])
    only_force = no_rate & ~no_force
    only_rate = no_force & ~no_rate
    rarer = min(np.count_nonzero(only_force), np.count_nonzero(only_rate))
    n_turns = np.count_nonzero(np.diff(only_force.astype(np.int8)))
    covered = np.count_nonzero(no_force | no_rate)
    if rarer < min_share * len(stream) or covered < min_covered * len(stream):
        return stream
    if n_turns < min_turns * rarer:
        return stream

    channels = dict(stream.channels)
    for quantity, is_missing in ((ACCELEROMETERS, no_force), (GYRO, no_rate)):
        channels[quantity] = np.where(is_missing[:, None], np.nan, channels[quantity])
    warnings.append(
        f"{stream.name}: its messages hold either acceleration or angular velocity, and"
        " zeros for the other; they are read as two channels, zeros as missing"
    )
    return replace(stream, channels=channels)


def _is_zero(values: Array) -> Mask:
    """Tell in which samples (M,) all readings (M, w) are exactly zero."""
    return np.asarray((values == 0.0).all(axis=1))


def rate_of(streams: Sequence[Stream]) -> float:
    """Return the rate [Hz] of an IMU's slowest channel; 0 where there is none."""
    rates_hz = []
    for stream in streams:
        for values in stream.channels.values():
            stamps = stream.stamp_ns[np.isfinite(values).any(axis=1)]
            if len(stamps) > 1:
                rates_hz.append(1e9 / max(float(np.median(np.diff(stamps))), 1.0))
    return min(rates_hz, default=0.0)
