"""Time put in where samples are lost, and the holes filled.

Stamps behind a loss are moved; the hole is filled by the cubic through positions and velocities of
both sides (which follows an arm over tens of milliseconds) and by straight lines through what else
was logged around it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from seqid_cli.logs.raw import Array, Mask, Rows, Stamps, Stream

REACH = 12  # samples on either side of a hole that tell the slope of the position at it


@dataclass(frozen=True)
class Losses:
    """Time `seconds` (K,) that is lost behind the samples `rows` (K,), in their order."""

    rows: Rows
    seconds: Array

    def __len__(self) -> int:
        return len(self.rows)


def with_losses(stream: Stream, losses: Losses) -> tuple[Stream, Mask]:
    """Move the stamps behind losses and fill the holes; tells the samples (M',) that fill them."""
    if not len(losses):
        return stream, np.zeros(len(stream), np.bool_)
    shift = np.zeros(len(stream), np.int64)
    shift[losses.rows + 1] = np.rint(losses.seconds * 1e9).astype(np.int64)
    stamps = stream.stamp_ns + np.cumsum(shift)
    usual = float(np.median(np.diff(stream.stamp_ns)))
    pieces, parts = [stamps], [dict(stream.channels)]
    for row in losses.rows:
        width = stamps[row + 1] - stamps[row]
        count = max(1, round(float(width) / usual)) - 1
        at = stamps[row] + (np.arange(1, count + 1) * (width / (count + 1))).astype(np.int64)
        pieces.append(at)
        parts.append({n: _filled(n, own, stamps, row, at) for n, own in stream.channels.items()})
    joined = np.concatenate(pieces)
    order = np.argsort(joined, kind="stable")
    channels = {n: np.concatenate([part[n] for part in parts])[order] for n in stream.channels}
    made = np.ones(len(joined), np.bool_)
    made[: len(stream)] = False
    return replace(stream, stamp_ns=joined[order], channels=channels), made[order]


def _filled(name: str, values: Array, stamps: Stamps, row: int, at: Stamps) -> Array:
    """Values (K, w) of one channel in the hole behind a sample."""
    x = (stamps - stamps[row]).astype(np.float64) * 1e-9
    seconds = (at - stamps[row]) * 1e-9
    reach = len(at) + 2 if name != "position" else REACH
    low, high = max(0, row + 1 - reach), min(len(x), row + 1 + reach)
    if name == "position":
        sides = (slice(low, row + 1), slice(row + 1, high))
        ends = x[[row, row + 1]]
        slopes = [_end_slopes(x, values, *side) for side in zip(sides, ends, strict=True)]
        curve = CubicHermiteSpline(ends, values[[row, row + 1]], np.array(slopes))
        return np.asarray(curve(seconds))
    line = np.polynomial.polynomial.polyfit(x[low:high], values[low:high], 1)
    return np.asarray(line[0] + seconds[:, None] * line[1])


def _end_slopes(x: Array, values: Array, rows: slice, at: float) -> Array:
    """Slopes (n,) of parabolas through some rows, at a moment."""
    c = np.polynomial.polynomial.polyfit(x[rows] - at, values[rows], 2)
    return np.asarray(c[1])
