"""Zero-phase low-pass of uniformly sampled channels, also of every M-th sample.

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
from numpy.fft import irfft, rfft

from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.spectra import fast_length
from seqid_cli.typing import Array, Index, Mask

ORDER = 4  # of one pass
SHORTEST = 8  # samples of a run that is filtered at all
NEGLIGIBLE = 1e-14
SHORT_RUN = 4.0  # pieces, up to which a run's pieces are fitted to its length


@dataclass(frozen=True)
class Lowpass:
    """Zero-phase low-pass of signals at `rate_hz`.

    They may be every `every`-th sample of a log; the response is that of the log's own
    rate.
    """

    cutoff_hz: float
    rate_hz: float
    every: int = 1

    @property
    def active(self) -> bool:
        """False where the cut-off is too close to the Nyquist rate to filter."""
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
        """Filter along the first axis, each run of valid samples by itself.

        Parameters
        ----------
        values : Array
            (N, ...), in single or double precision.
        valid : Mask, optional
            (N,), false where samples must not leak into others; these are returned as
            they are.
        times : int
            Number of passes.
        every : int
            Samples 0, `every`, 2 `every`, ... are returned only.

        Returns
        -------
        Array
            (N / every, ...), in the precision of the values.
        """
        kind = np.float32 if values.dtype == np.float32 else np.float64
        rows: Array = np.array(values.reshape(len(values), -1).T, dtype=kind, order="C")
        filtered: Array = rows if every == 1 else np.array(rows[:, ::every])
        self.filter_rows(rows, valid, into=filtered, times=times, every=every)
        return np.ascontiguousarray(filtered.T).reshape(-1, *values.shape[1:])

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
        """Filter signals in rows, each run of valid samples by itself.

        Parameters
        ----------
        rows : Array
            (c, N).
        valid, times, every
            As of a call.
        only : Index, optional
            Numbers of the signals to filter; all by default.
        into : Array, optional
            (c, N / every), where they go, by default in place. What is not filtered
            stays as it is.
        tile : int
            Values that are worked on at once.
        """
        target = rows if into is None else into
        chosen = np.arange(len(rows)) if only is None else only
        if not self.active:
            return
        for start, stop in runs(valid, rows.shape[1]):
            # Columns of the target, counted in steps of `every`, that lie in the run.
            first = -(-start // every)
            last = -(-stop // every)
            if stop - start <= SHORTEST or first * every >= stop:
                continue

            length = stop - start + 2 * times * self.memory
            n_rows = max(1, tile // length)
            for top in range(0, len(chosen), n_rows):
                some = chosen[top : top + n_rows]
                run = rows[some, start:stop]
                target[some, first:last] = self._filtered(
                    run, times, every, first * every - start
                )

    def _filtered(self, rows: Array, times: int, every: int, first: int) -> Array:
        """Filter rows (c, N), prolonged by point reflections at their ends.

        Every `every`-th sample from `first` on is returned. What a pass makes of the
        prolonged signal is prolonged in the same way, so that passes at once are passes
        one by one.
        """
        samples = rows.shape[1]
        response = _response(self, times, every)
        if samples <= SHORT_RUN * (response.size - 2 * response.reach):
            response = _response(self, times, every, samples)
        reach = response.reach
        if samples <= reach:
            margins = ((0, 0), (reach, reach))
            wide = np.pad(rows, margins, mode="reflect", reflect_type="odd")
        else:  # the same, faster
            before = 2.0 * rows[:, :1] - rows[:, reach:0:-1]
            behind = 2.0 * rows[:, -1:] - rows[:, -2 : -reach - 2 : -1]
            wide = np.concatenate([before, rows, behind], axis=1)

        # Overlap-save: each piece is as long as the transform, less what wraps around.
        hop = response.size - 2 * reach
        filtered = np.empty((len(rows), -(-(samples - first) // every)), rows.dtype)
        for start in range(first, samples, hop):
            stop = min(start + hop, samples)
            piece = response.of(wide[:, start : stop + 2 * reach])
            at = slice((start - first) // every, -(-(stop - first) // every))
            filtered[:, at] = piece[:, : at.stop - at.start]
        return filtered


def single(values: Array) -> Array:
    """Return values in single precision, which is enough for columns of an effect."""
    return cast(Array, values.astype(np.float32))


class _Response:
    """Gain of some passes, for pieces of `longer` reaches and `least` samples or more.

    A short run has pieces of one length: the end of it would else be a piece of a few
    samples, for which the transform is as long as for any other.

    Attributes
    ----------
    every : int
        Of so many samples one is wanted.
    reach : int
        Samples on either side that a filtered one depends on, a multiple of `every`.
    size : int
        Of the Fourier transform.
    gain : Array
        (size / 2 + 1,), real: the phase is zero.
    """

    def __init__(
        self,
        lowpass: Lowpass,
        times: int,
        every: int,
        run: int | None = None,
        *,
        longer: int = 8,
        least: int = 512,
    ) -> None:
        h = impulse_response(lowpass)
        half = len(h) // 2
        self.every = every
        self.reach = -(-times * half // every) * every
        wanted = longer * self.reach + least
        if run is not None:
            pieces = max(1, round(run / (wanted - 2 * self.reach)))
            wanted = -(-run // pieces) + 2 * self.reach
        self.size = every * fast_length(-(-wanted // every))

        # The middle of h at sample 0, so that the phase is zero.
        padded = np.zeros(self.size)
        padded[: len(h)] = h
        self.gain = rfft(np.roll(padded, -half)).real ** times

    def of(self, piece: Array) -> Array:
        """Filter a piece (c, m), from its sample `reach` on; zeros follow it."""
        spectrum = rfft(piece, self.size)
        spectrum *= self.gain.astype(piece.dtype)
        size = self.size // self.every
        highest = self.size // 2
        half = size // 2 + 1
        folded = spectrum if self.every == 1 else spectrum[:, :half].copy()

        # Of every M-th sample: what lies above half its rate comes back below.
        for turn in range(size, highest + 1, size):
            above = spectrum[:, turn : turn + half]
            if turn < highest:
                folded[:, : above.shape[1]] += above
            folded += spectrum[:, turn - half + 1 : turn + 1][:, ::-1].conj()
        filtered = irfft(folded, size)
        filtered /= self.every
        return np.asarray(filtered[:, self.reach // self.every :])


@lru_cache(maxsize=64)
def impulse_response(lowpass: Lowpass) -> Array:
    """Return h (2 memory + 1,) of both ways together, with a gain of 1 at rest."""
    # In cycles per sample of the log. The transform is long enough for h to decay to
    # nothing, from either end of the axis.
    cutoff = lowpass.cutoff_hz / (lowpass.rate_hz * lowpass.every)
    size = 1 << int(np.ceil(np.log2(32.0 / min(cutoff, 0.5 - cutoff))))
    frequency = np.arange(size // 2 + 1) / size
    ratio = np.tan(np.pi * frequency) / np.tan(np.pi * cutoff)
    gain = 1.0 / (1.0 + ratio ** (2 * ORDER))

    h = irfft(gain, size)[: size // 2 : lowpass.every]
    memory = int(np.flatnonzero(np.abs(h) > NEGLIGIBLE * h[0])[-1])
    symmetric = np.concatenate([h[memory:0:-1], h[: memory + 1]])
    return np.asarray(symmetric / symmetric.sum())


_response = lru_cache(maxsize=256)(_Response)
