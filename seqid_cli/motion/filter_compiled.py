"""The zero-phase low-pass as compiled loops: second-order sections, several signals side by side.

What `scipy.signal.sosfiltfilt` does, in the same order and without fusing products and sums: a low
cut-off makes much of rounding. A recursive filter cannot be made parallel in
time, so `LANES` signals are laid across each other, sample by sample, and filtered in step.

Imported only where `seqid_cli.compiled` says so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import sosfilt_zi

from seqid_cli.compiled import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SECTIONS = 2
LANES = 16
PART = 64  # samples laid across at once: they stay in cache


def both_ways(rows: Array, which: Ints, start: int, stop: int, sos: Array, pad: int) -> None:
    """Filter signals in place, forward and backward, prolonged by point reflection.

    What goes on at both ends is filtered by `on_both_ways`.

    Parameters
    ----------
    rows : (c, N) array, C-ordered
    which : (k,) array
        The signals to filter.
    start, stop : int
        The samples to filter, as if there were no others.
    sos : (2, 6) array
        Second-order sections of one pass.
    pad : int
        Samples of the reflection at either end, fewer than are filtered.
    """
    room = np.empty((stop - start + 2 * pad) * LANES)
    none = np.empty((0, 2 * SECTIONS))
    _both_ways(rows, which, start, stop, *_factors(sos), none, stop - start, pad, room)


def on_both_ways(
    rows: Array, which: Ints, stop: int, count: int, sos: Array, states: Array
) -> None:
    """Filter the next samples of signals in place, forward and backward.

    Parameters
    ----------
    rows : (c, N) array, C-ordered
    which : (k,) array
        The signals to filter.
    stop : int
        Samples that are known; the filter has to forget what follows them.
    count : int
        Samples to filter, from the first one on; a multiple of `PART` if more will follow.
    sos : (2, 6) array
        Second-order sections of one pass.
    states : (k, 4) array, C-ordered
        Of the forward pass in front of the first sample; behind the last one filtered on return.
    """
    room = np.empty(stop * LANES)
    _both_ways(rows, which, 0, stop, *_factors(sos), states, count, 0, room)


def _factors(sos: Array) -> tuple[Array, Array]:
    """What the sections multiply with, and their states at rest at 1."""
    factors = np.ascontiguousarray(sos[:, [0, 1, 2, 4, 5]] / sos[:, 3:4])
    return factors, np.ascontiguousarray(sosfilt_zi(sos))


@compiled()
def _lay(x: Array, lane: int, signal: Array, pad: int, low: int, high: int) -> None:
    """Lay samples [low, high) of a signal with its reflections into its lane."""
    count = len(signal)
    if low >= pad and high <= pad + count:
        part = signal[low - pad : high - pad]
        for k in range(len(part)):
            x[k * LANES + lane] = part[k]
        return
    for k in range(high - low):
        at = low + k - pad
        if at < 0:
            x[k * LANES + lane] = 2.0 * signal[0] - signal[-at]
        elif at >= count:
            x[k * LANES + lane] = 2.0 * signal[count - 1] - signal[2 * count - 2 - at]
        else:
            x[k * LANES + lane] = signal[at]


@compiled()
def _take(x: Array, lane: int, signal: Array, pad: int, low: int, high: int) -> None:
    """Take samples [low, high) back from a lane, without the reflections."""
    first, last = max(low, pad), min(high, pad + len(signal))
    if first < last:
        part = signal[first - pad : last - pad]
        offset = first - low
        for k in range(len(part)):
            part[k] = x[(offset + k) * LANES + lane]


@compiled()
def _begin(state: Array, steady: Array, x: Array) -> None:
    """Start as if the signals had always had the values that they have now."""
    for section in range(SECTIONS):
        for k in range(LANES):
            state[2 * section * LANES + k] = steady[section, 0] * x[k]
            state[(2 * section + 1) * LANES + k] = steady[section, 1] * x[k]


@compiled()
def _exchange(state: Array, states: Array, taken: bool) -> None:
    """Take the states of signals (k, 4) into their lanes, or give them back."""
    for lane in range(len(states)):
        for k in range(2 * SECTIONS):
            if taken:
                state[k * LANES + lane] = states[lane, k]
            else:
                states[lane, k] = state[k * LANES + lane]


@compiled(fused=False)
def _filter(x: Array, factors: Array, state: Array, back: bool) -> None:
    """Filter (count LANES,) in place, in the transposed direct form II."""
    b00, b01, b02, a01, a02 = factors[0]
    b10, b11, b12, a11, a12 = factors[1]
    count = len(x) // LANES
    for step in range(count):
        at = (count - 1 - step if back else step) * LANES
        now = x[at : at + LANES]
        for k in range(LANES):
            u = now[k]
            v = b00 * u + state[k]
            state[k] = b01 * u - a01 * v + state[LANES + k]
            state[LANES + k] = b02 * u - a02 * v
            y = b10 * v + state[2 * LANES + k]
            state[2 * LANES + k] = b11 * v - a11 * y + state[3 * LANES + k]
            state[3 * LANES + k] = b12 * v - a12 * y
            now[k] = y


@compiled(
    "void(f8[:,::1], i8[::1], i8, i8, f8[:,::1], f8[:,::1], f8[:,::1], i8, i8, f8[::1])",
    fused=False,
)
def _both_ways(
    rows: Array,
    which: Ints,
    start: int,
    stop: int,
    factors: Array,
    steady: Array,
    states: Array,
    count: int,
    pad: int,
    room: Array,
) -> None:
    total = stop - start + 2 * pad
    state = np.empty(2 * SECTIONS * LANES)
    for top in range(0, len(which), LANES):
        lanes = min(LANES, len(which) - top)
        for low in range(0, total, PART):
            high = min(low + PART, total)
            x = room[low * LANES : high * LANES]
            if lanes < LANES:
                x[:] = 0.0
            for lane in range(lanes):
                _lay(x, lane, rows[which[top + lane], start:stop], pad, low, high)
            if low == 0:
                _begin(state, steady, x[:LANES])
            if len(states) and (low == 0 or low == count):
                _exchange(state, states[top : top + lanes], low == 0)
            _filter(x, factors, state, False)
        _begin(state, steady, room[(total - 1) * LANES : total * LANES])
        for high in range(total, 0, -PART):
            low = max(0, high - PART)
            x = room[low * LANES : high * LANES]
            _filter(x, factors, state, True)
            for lane in range(lanes):
                _take(x, lane, rows[which[top + lane], start : start + count], pad, low, high)
