"""Zero-phase low-pass of uniformly sampled channels: one filter, in blocks, at all or some samples.

The low-pass is a fourth-order Butterworth run forward and backward, so its gain is the squared one
and its phase zero. Every quantity of one equation goes through the same filter (parallel
filtering): a linear equation stays exact whatever the cut-off, only its information shrinks.

One pass with state s (m,), s+ = A s + B x, y = C s + D x, taken over blocks of L samples, is

    y = T x + O s,      s after the block = A^L s + K x,

T (L, L) being the Toeplitz matrix of its impulse response, O = [C; C A; ...] and
K = [A^(L-1) B ... B] (block realisation of recursive filters, C. S. Burrus, IEEE Trans. Audio
Electroacoust. 20 (1972) 230). Run backwards, with state z, the matrices are the same ones mirrored
(T', O', K'), and both ways together are one product,

    y = T' (T x + O s) + O' z,      z before the block = A^L z + K' (T x + O s).

Only the states go from block to block. Where M-th samples are all that is wanted of y, a few rows
of these matrices are all that is needed, and derivatives of y are sums of rows. Two passes are one
filter of twice the order: away from the ends of a signal, forward, backward, forward and backward
is the same as twice forward and twice backward.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import toeplitz
from scipy.linalg.blas import dgemm
from scipy.signal import lfilter

from seqid_cli.motion.filters.design import ORDER, one_pass
from seqid_cli.motion.filters.differentiation import FIRST, SECOND, SIDE, runs
from seqid_cli.typing import Array, Index, Mask

SHORTEST = 8  # samples of a run that is filtered at all
LEAST_KEPT = 2 * SIDE + 1  # samples per kept one, so that its derivatives lie in one block
NEGLIGIBLE = 1e-13
GROWS = 64  # samples more than the memory, for what grows before it decays


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
        """Samples after which one pass of the filter has forgotten what was before (to 1e-13)."""
        if not self.active:
            return 0
        A = one_pass(self.cutoff_hz, self.rate_hz, self.every).A
        slowest = float(np.abs(np.linalg.eigvals(A)).max())
        return int(np.ceil(np.log(NEGLIGIBLE) / np.log(slowest))) + 1 + GROWS

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
        they are. `only`: numbers of the signals to filter; all by default.
        """
        if not self.active:
            return
        kernel = _kernel(self.cutoff_hz, self.rate_hz, self.every)
        count = len(rows) if only is None else len(only)
        for start, stop in runs(valid, rows.shape[1]):
            if stop - start <= SHORTEST:
                continue
            pad = min(6 * self.settling, stop - start - 1)
            height = max(1, tile // (stop - start + 2 * pad))
            for top in range(0, count, height):
                own = slice(top, top + height)
                part = own if only is None else _as_slice(only[own])
                rows[part, start:stop] = kernel.both_ways(rows[part, start:stop], pad)

    def can_decimate(self, every: int) -> bool:
        """Whether `decimated` serves to keep every so many samples."""
        return self.active and every >= LEAST_KEPT

    def decimated(
        self,
        values: Array,
        every: int,
        first: int,
        count: int,
        *,
        passes: int = 1,
        derivatives: bool = False,
    ) -> Array:
        """Filter signals without ends or gaps, at every so many samples only.

        `values` (N, c): with as many samples in front of what is wanted and behind as the filter
        remembers. `every`: samples per kept one, see `can_decimate`. `first`: number of the first
        sample to keep. `count`: how many to keep. `passes`: how often the signals go through the
        low-pass: 1 or 2. `derivatives`: whether first and second derivative, as of `differentiate`,
        are wanted as well. Returns (1 or 3, count, c): values, per second and per second squared.
        """
        kernel = _kernel(self.cutoff_hz, self.rate_hz, self.every, every, passes, derivatives)
        ahead, low = divmod(first - every // 2, kernel.length)
        blocks = (len(values) - low) // kernel.length
        x = np.ascontiguousarray(values[low : low + blocks * kernel.length].T)
        y = kernel(x.reshape(-1, kernel.length), values.shape[1])
        y = y.reshape(values.shape[1], blocks, kernel.outputs, -1)[:, ahead:]
        kept = y.transpose(2, 1, 3, 0).reshape(kernel.outputs, -1, values.shape[1])
        return np.ascontiguousarray(kept[:, :count])


def _as_slice(numbers: Index) -> Index | slice:
    """Ascending numbers without a gap as a slice: what it takes is no copy."""
    low, high = int(numbers[0]), int(numbers[-1]) + 1
    return slice(low, high) if high - low == len(numbers) else numbers


@dataclass(frozen=True)
class _Kernel:
    """Block matrices of one filter, transposed; see the module's text."""

    length: int  # L, of a block
    outputs: int  # per kept sample
    from_x: Array  # (L, 2 m + k): to what is added to s and z, and to the outputs of a block
    from_s: Array  # (m, m): to what is added to z
    from_states: Array  # (2 m, k): s, z to the outputs
    over_block: Array  # (m, m): A^L
    last: Array  # (L + m,): x, s to the last sample of one pass
    steady: Array  # (m,): state at x = 1

    def both_ways(self, rows: Array, pad: int) -> Array:
        """Filter (c, N) forward and backward, prolonged by point reflection."""
        count, samples = rows.shape
        blocks = -(-(samples + 2 * pad) // self.length)
        x = _extended(rows, pad, blocks * self.length)
        y = self(x.reshape(-1, self.length), count).reshape(count, -1)
        stop = y.shape[1] - pad
        return y[:, stop - samples : stop]

    def __call__(self, x: Array, count: int) -> Array:
        """Filter so many signals of b blocks each, (count b, L), to outputs (count b, k).

        A signal is taken to have had its first value for ever; what one pass has made of its last
        one goes on behind it.
        """
        m, length = len(self.steady), self.length
        grown = x @ self.from_x[:, : 2 * m]
        ends = x.reshape(count, -1, length)[:, [0, -1]]
        s = _scanned(ends[:, 0, :1] * self.steady, grown[:, :m], self.over_block)
        last = ends[:, 1] @ self.last[:length] + s.reshape(count, -1, m)[:, -1] @ self.last[length:]
        added = grown[:, m:] + s @ self.from_s
        z = _scanned(last[:, None] * self.steady, added, self.over_block, back=True)
        y = x @ self.from_x[:, 2 * m :]
        states = np.concatenate([s, z], axis=1)
        dgemm(1.0, self.from_states.T, states.T, 1.0, y.T, overwrite_c=True)  # y += states @ ...
        return np.asarray(y)


def _scanned(start: Array, added: Array, step: Array, *, back: bool = False) -> Array:
    """States (c b, m) before each block: x+ = step x + added, from the start (c, m)."""
    # `added` is (c b, m); `back` goes from the last block to the first. Two numbers are one mode,
    # and modes of a second pass are driven by those of the first.
    grown = added.reshape(len(start), -1, start.shape[1])
    grown = (grown[:, ::-1] if back else grown)[:, :-1]
    states = np.concatenate([start[:, None], grown], axis=1)
    modes = states.view(np.complex128)
    for k in range(0, states.shape[2], 2):
        if k >= ORDER:
            states[:, 1:, k : k + 2] += states[:, :-1, :ORDER] @ step[k : k + 2, :ORDER].T
        pole = complex(step[k, k], step[k + 1, k])
        modes[:, :, k // 2] = lfilter([1.0], [1.0, -pole], modes[:, :, k // 2], axis=1)
    return np.ascontiguousarray(states[:, ::-1] if back else states).reshape(added.shape)


def _extended(rows: Array, pad: int, length: int) -> Array:
    """Signals (c, length) with reflections (c, N) of so many samples; the first value before."""
    wide = np.empty((len(rows), length))
    stop = length - pad
    start = stop - rows.shape[1]
    wide[:, start:stop] = rows
    np.subtract(2 * rows[:, :1], rows[:, pad:0:-1], out=wide[:, start - pad : start])
    np.subtract(2 * rows[:, -1:], rows[:, -2 : -2 - pad : -1], out=wide[:, stop:])
    wide[:, : start - pad] = wide[:, start - pad, None]
    return wide


@lru_cache(maxsize=64)
def _kernel(
    cutoff_hz: float,
    rate_hz: float,
    every: int,
    keep: int = 1,
    passes: int = 1,
    derivatives: bool = False,
    *,
    block: int = 48,
    block_of_kept: int = 96,
) -> _Kernel:
    """Lay out the matrices; `keep` is samples per kept one, the rest as of `Lowpass.decimated`."""
    space = one_pass(cutoff_hz, rate_hz, every)
    space = space.twice() if passes == 2 else space
    length = block if keep == 1 else keep * -(-block_of_kept // keep)
    steps, rows = [space.B], [space.C]
    for _ in range(length - 1):
        steps.append(space.A @ steps[-1])
        rows.append(rows[-1] @ space.A)
    response = np.array([space.D, *(space.C @ step for step in steps[:-1])])
    T, O = toeplitz(response, np.zeros(length)), np.array(rows)
    K = np.array(steps[::-1]).T
    K_back, O_back = K[:, ::-1], O[::-1]
    taps = [np.eye(2 * SIDE + 1)[SIDE]]
    if derivatives:
        taps += [FIRST * rate_hz, SECOND * rate_hz**2]
    kept = np.eye(length) if keep == 1 else _placed(np.array(taps), keep, length)
    direct = kept @ T.T
    return _Kernel(
        length,
        len(taps),
        from_x=np.ascontiguousarray(np.concatenate([K, K_back @ T, direct @ T]).T),
        from_s=np.ascontiguousarray((K_back @ O).T),
        from_states=np.concatenate([(direct @ O).T, (kept @ O_back).T]),
        over_block=np.linalg.matrix_power(space.A, length),
        last=np.concatenate([T[-1], O[-1]]),
        steady=space.steady,
    )


def _placed(taps: Array, keep: int, length: int) -> Array:
    """Rows (taps places, L) that take taps (k, 9) about the kept samples; places go fastest."""
    places = keep // 2 + keep * np.arange(length // keep)
    rows = np.zeros((len(taps), len(places), length))
    for number, place in enumerate(places):
        rows[:, number, place - SIDE : place + SIDE + 1] = taps
    return rows.reshape(-1, length)
