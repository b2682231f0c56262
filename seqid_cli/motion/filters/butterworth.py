"""Zero-phase low-pass of uniformly sampled channels, also of every M-th sample of a log.

The low-pass is a fourth-order Butterworth run forward and backward: its phase is zero,
and its gain is the squared one,

    |H(f)|^2 = 1 / (1 + (tan(pi f / rate) / tan(pi cutoff / rate))^8).

Every quantity of one equation goes through the same filter (parallel filtering): a
linear equation stays exact whatever the cut-off, only its information shrinks.

Both ways together are a convolution with one symmetric impulse response h, the inverse
Fourier transform of that gain. It is cut off where it has decayed to 1e-14, and applied
to overlapping pieces by the fast Fourier transform (overlap-save).

A filter designed for every M-th sample is not the filter that ran at the full rate:
near its cut-off the two differ by what the frequency axis is bent. Terms computed from
decimated motion must see the filter that the torque has seen, so theirs has the
response M h[M k] (impulse invariance). Both differ only by what lies above half of the
kept rate, 3e-6 at ten samples per period of the cut-off.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Array, Index, Mask

ORDER = 4  # of one pass
SHORTEST = 8  # samples of a run that is filtered at all
NEGLIGIBLE = 1e-14


@dataclass(frozen=True)
class Lowpass:
    """Zero-phase low-pass of signals at `rate_hz`, which may be each `every`-th sample of a log.

    The response is that of the log's own rate.
    """

    cutoff_hz: float
    rate_hz: float
    every: int = 1

    @property
    def active(self) -> bool:
        """False where the cut-off lies too close to the Nyquist rate to filter anything."""
        return self.cutoff_hz < 0.45 * self.rate_hz

    @property
    def settling(self) -> int:
        """Samples near an end that still feel the missing data beyond it."""
        return int(np.ceil(0.6 * self.rate_hz / self.cutoff_hz)) + 4

    @property
    def memory(self) -> int:
        """Samples on either side that a filtered one depends on (to 1e-14)."""
        return len(impulse_response(self)) // 2 if self.active else 0

    def __call__(
        self,
        values: Array,
        valid: Mask | None = None,
        *,
        times: int = 1,
        every: int = 1,
    ) -> Array:
        """Filter (N, ...) in its precision along the first axis, each valid run by itself.

        `valid` (N,): false where samples must not leak into others; these are returned
        as they are. `times`: number of passes. `every`: samples 0, `every`, 2 `every`,
        ... are returned only.
        """
        kind = np.float32 if values.dtype == np.float32 else np.float64
        rows: Array = np.array(values.reshape(len(values), -1).T, dtype=kind, order="C")
        kept: Array = rows if every == 1 else np.array(rows[:, ::every])
        self.filter_rows(rows, valid, into=kept, times=times, every=every)
        return np.ascontiguousarray(kept.T).reshape(-1, *values.shape[1:])

    def filter_rows(
        self,
        rows: Array,
        valid: Mask | None = None,
        *,
        only: Index | None = None,
        into: Array | None = None,
        times: int = 1,
        every: int = 1,
        tile: int = 131072,
    ) -> None:
        """Filter signals `rows` (c, N), each run of valid samples by itself.

        `only`: numbers of the signals to filter; all by default. `into` (c, N / every):
        where they go, by default in place. What is not filtered stays as it is. `tile`:
        values that are worked on at once. Others: as of a call.
        """
        kept = rows if into is None else into
        chosen = np.arange(len(rows)) if only is None else only
        for start, stop in runs(valid, rows.shape[1]) if self.active else ():
            first = -(-start // every)
            if stop - start <= SHORTEST or first * every >= stop:
                continue
            last = -(-stop // every)
            height = max(1, tile // (stop - start + 2 * times * self.memory))
            for top in range(0, len(chosen), height):
                own = chosen[top : top + height]
                run = rows[own, start:stop]
                kept[own, first:last] = self._filtered(
                    run, times, every, first * every - start
                )

    def _filtered(self, rows: Array, times: int, every: int, first: int) -> Array:
        """Filter (c, N), prolonged by point reflections at its ends, samples from `first` on."""
        # What a pass makes of the prolonged signal is prolonged in the same way, so
        # that passes at once are passes one by one.
        response = _response(self, times, every)
        samples, reach = rows.shape[1], response.reach
        hop = response.size - 2 * reach
        if samples <= reach:
            wide = np.pad(
                rows, ((0, 0), (reach, reach)), mode="reflect", reflect_type="odd"
            )
        else:  # the same, faster
            before, behind = rows[:, reach:0:-1], rows[:, -2 : -reach - 2 : -1]
            ends = 2.0 * rows[:, :1] - before, 2.0 * rows[:, -1:] - behind
            wide = np.concatenate([ends[0], rows, ends[1]], axis=1)
        kept = np.empty((len(rows), -(-(samples - first) // every)), rows.dtype)
        for start in range(first, samples, hop):
            stop = min(start + hop, samples)
            piece = response.of(wide[:, start : stop + 2 * reach])
            at = slice((start - first) // every, -(-(stop - first) // every))
            kept[:, at] = piece[:, : at.stop - at.start]
        return kept


def single(values: Array) -> Array:
    """The same values in single precision, which is enough for columns of an effect."""
    return cast(Array, values.astype(np.float32))


class _Response:
    """Gain of some passes over pieces of `longer` reaches and `least` samples, or a little more."""

    def __init__(
        self,
        lowpass: Lowpass,
        times: int,
        every: int,
        *,
        longer: int = 8,
        least: int = 512,
    ) -> None:
        h = impulse_response(lowpass)
        self.every = every  # of so many samples one is wanted
        # that depend, on either side
        self.reach = -(-times * (len(h) // 2) // every) * every
        self.size = every * next_fast_len(
            -(-(longer * self.reach + least) // every), real=True
        )
        both = np.zeros(self.size)
        both[: len(h)] = h
        # the phase is zero
        self.gain = rfft(np.roll(both, -(len(h) // 2))).real ** times

    def of(self, piece: Array) -> Array:
        """Filter a piece (c, m), from its sample `reach` on; zeros follow it."""
        spectrum = rfft(piece, self.size)
        spectrum *= self.gain.astype(piece.dtype)
        size, highest = self.size // self.every, self.size // 2
        half = size // 2 + 1
        folded = spectrum if self.every == 1 else spectrum[:, :half].copy()
        # Of every M-th sample: what lies above half its rate comes back below.
        for turn in range(size, highest + 1, size):
            above = spectrum[:, turn : turn + half]
            folded[:, : above.shape[1]] += above * (turn < highest)
            folded += spectrum[:, turn - half + 1 : turn + 1][:, ::-1].conj()
        found = irfft(folded, size)
        found /= self.every
        return np.asarray(found[:, self.reach // self.every :])


@lru_cache(maxsize=64)
def impulse_response(lowpass: Lowpass) -> Array:
    """Response (2 memory + 1,) of both ways, with a gain of 1 at rest."""
    cutoff = lowpass.cutoff_hz / (lowpass.rate_hz * lowpass.every)
    # Long enough to decay to nothing, from either end of the axis.
    size = 1 << int(np.ceil(np.log2(32.0 / min(cutoff, 0.5 - cutoff))))
    ratio = np.tan(np.pi * np.arange(size // 2 + 1) / size) / np.tan(np.pi * cutoff)
    h = irfft(1.0 / (1.0 + ratio ** (2 * ORDER)), size)[: size // 2 : lowpass.every]
    reach = int(np.flatnonzero(np.abs(h) > NEGLIGIBLE * h[0])[-1])
    both = np.concatenate([h[reach:0:-1], h[: reach + 1]])
    return np.asarray(both / both.sum())


_response = lru_cache(maxsize=64)(_Response)
