"""Zero-phase low-pass of uniformly sampled channels, also of every M-th sample of a log.

The low-pass is a fourth-order Butterworth run forward and backward: its phase is zero, and its gain
is the squared one,

    |H(f)|^2 = 1 / (1 + (tan(pi f / rate) / tan(pi cutoff / rate))^8).

Every quantity of one equation goes through the same filter (parallel filtering): a linear equation
stays exact whatever the cut-off, only its information shrinks.

Both ways together are a convolution with one symmetric impulse response h, the inverse Fourier
transform of that gain. It is cut off where it has decayed to 1e-14, and applied to overlapping
pieces by the fast Fourier transform (overlap-save).

A filter designed for every M-th sample is not the filter that ran at the full rate: near its
cut-off the two differ by what the frequency axis is bent. Terms computed from decimated motion must
see the filter that the torque has seen, so theirs has the response M h[M k] (impulse invariance).
Both differ only by what lies above half of the kept rate, 3e-6 at ten samples per period of the
cut-off.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Array, Complex, Index, Mask

ORDER = 4  # of one pass
SHORTEST = 8  # samples of a run that is filtered at all
NEGLIGIBLE = 1e-14


@dataclass(frozen=True)
class Lowpass:
    """Zero-phase low-pass at `cutoff_hz` for signals sampled at `rate_hz`.

    Where they are every `every`-th sample of a log, the filter has the response that it has at the
    log's own rate.
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

    def __call__(self, values: Array, valid: Mask | None = None) -> Array:
        """Filter along the first axis, each run of valid samples by itself.

        `values` (N, ...): samples in time order. `valid` (N,): false where samples must not leak
        into others. Returns (N, ...): filtered values; samples outside valid runs are returned as
        they came.
        """
        rows = np.array(values.reshape(len(values), -1).T, dtype=np.float64, order="C")
        self.filter_rows(rows, valid)
        return np.ascontiguousarray(rows.T).reshape(values.shape)

    def filter_rows(
        self,
        rows: Array,
        valid: Mask | None = None,
        *,
        only: Index | None = None,
        tile: int = 131072,
    ) -> None:
        """Filter signals in place, samples last, each run of valid samples by itself.

        `rows` (c, N). `valid` (N,): false where samples must not leak into others; these stay as
        they are. `only`: numbers of the signals to filter; all by default. `tile`: values that are
        worked on at once.
        """
        if not self.active:
            return
        chosen = np.arange(len(rows)) if only is None else only
        for start, stop in runs(valid, rows.shape[1]):
            if stop - start <= SHORTEST:
                continue
            height = max(1, tile // (stop - start + 2 * self.memory))
            for top in range(0, len(chosen), height):
                own = chosen[top : top + height]
                rows[own, start:stop] = self._filtered(rows[own, start:stop])

    def _filtered(self, rows: Array) -> Array:
        """Filter (c, N), prolonged by point reflection and then as it ends."""
        reach, samples = self.memory, rows.shape[1]
        pad = min(6 * self.settling, samples - 1)
        wide = np.pad(rows, ((0, 0), (pad, pad)), mode="reflect", reflect_type="odd")
        wide = np.pad(wide, ((0, 0), (max(0, reach - pad),) * 2), mode="edge")
        first, (size, spectrum) = max(0, pad - reach), _transformed(self)
        found, step = np.empty_like(rows), size - 2 * reach
        for start in range(0, samples, step):
            stop = min(start + step, samples)
            piece = rfft(wide[:, first + start : first + stop + 2 * reach], size)
            piece *= spectrum
            found[:, start:stop] = irfft(piece, size)[:, 2 * reach : 2 * reach + stop - start]
        return found


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


@lru_cache(maxsize=64)
def _transformed(lowpass: Lowpass, *, longer: int = 8, least: int = 512) -> tuple[int, Complex]:
    """Length of the transforms, `longer` memories and `least` samples, and the response's own."""
    size = next_fast_len(longer * lowpass.memory + least, real=True)
    return size, np.asarray(rfft(impulse_response(lowpass), size))
