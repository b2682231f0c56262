"""The zero-phase low-pass of a long signal, evaluated at every M-th sample only.

With the block matrices of `block_filter`, a block of L samples x between the states s in front of
it and z behind it has

    y = T' T x + T' O s + O' z.

Where M-th samples are all that is wanted of y, a few rows of these matrices are all that is needed,
and derivatives of y are sums of rows; per sample, what x adds to the states is most of the work.
Two passes of the filter are one filter of twice the order: away from the ends of a signal, forward,
backward, forward and backward is the same as twice forward and twice backward.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from seqid_cli.motion.block_filter import (
    LOWEST,
    as_double,
    block_matrices,
    powers_of,
    scanned,
    state_space,
)
from seqid_cli.motion.filtering import _FIRST, _SECOND, sections

Array = NDArray[np.float64]
Wide = NDArray[np.longdouble]

SIDE = len(_FIRST) // 2  # samples on either side that a derivative takes
LEAST = 2 * SIDE + 1  # samples per kept one, so that these lie in one block
BLOCK = 96  # samples in a block, at least


@dataclass(frozen=True)
class KeptFilter:
    """Block matrices of one filter and one choice of what is kept; see the module's text."""

    every: int
    length: int  # of a block, a multiple of `every`
    before: int  # samples of a block in front of the first kept one
    outputs: int  # per kept sample
    from_x: Array  # (L, 2 m + k): to what is added to s and z, and to the outputs of a block
    from_s: Array  # (m, m + k): to what is added to z, and to the outputs
    from_z: Array  # (m, k): to the outputs
    over_block: Array  # (m, m): A^L, transposed
    steady: Array  # (m,): state at x = 1

    def __call__(self, signal: Array, first: int, count: int) -> Array:
        """Filter a signal.

        Parameters
        ----------
        signal : (N,) array
            With as many samples in front of what is wanted and behind as the filter remembers.
        first : int
            Number of the first sample to keep.
        count : int
            How many to keep.

        Returns
        -------
        (outputs, count) array
        """
        m, length = len(self.steady), self.length
        ahead = (first - self.before) // length  # blocks
        low = first - self.before - ahead * length
        blocks = (len(signal) - low) // length
        x = signal[low : low + blocks * length].reshape(blocks, length)
        grown = x @ self.from_x
        s = scanned(x[0, 0] * self.steady, grown[:, :m], self.over_block)
        by_s = s @ self.from_s
        last = x[-1, -1] * self.steady
        z = scanned(last, (grown[:, m : 2 * m] + by_s[:, :m])[::-1], self.over_block)[::-1]
        y = grown[:, 2 * m :] + by_s[:, m:]
        y += z @ self.from_z
        kept = y[ahead:].reshape(blocks - ahead, self.outputs, -1).transpose(1, 0, 2)
        return kept.reshape(self.outputs, -1)[:, :count]


def can_keep(cutoff_hz: float, rate_hz: float, every: int) -> bool:
    """Whether `kept_filter` serves, and serves to 1e-12."""
    return every >= LEAST and cutoff_hz >= LOWEST * rate_hz


@lru_cache(maxsize=64)
def kept_filter(
    cutoff_hz: float, rate_hz: float, every: int, *, passes: int = 1, derivatives: bool = False
) -> KeptFilter:
    """Lay out the filter.

    Parameters
    ----------
    cutoff_hz, rate_hz : float
        As for `Lowpass`, at the signal's own rate.
    every : int
        Samples per kept one, at least `LEAST`.
    passes : int
        How often the signal goes through the low-pass.
    derivatives : bool
        Whether first and second derivative, as of `differentiate`, are outputs as well.
    """
    design = np.concatenate([sections(cutoff_hz, rate_hz)] * passes).astype(np.longdouble)
    A, B, C, D, steady = state_space(design)
    length = every * -(-BLOCK // every)
    T, O, K = block_matrices(A, B, C, D, length)
    K_back, T_back, O_back = K[:, ::-1], T.T, O[::-1]
    taps = [np.eye(2 * SIDE + 1)[SIDE]]
    if derivatives:
        taps += [_FIRST * rate_hz, _SECOND * rate_hz**2]
    before = every // 2
    chosen = _placed(np.array(taps), before + every * np.arange(length // every), length)
    direct = chosen @ T_back
    return KeptFilter(
        every,
        length,
        before,
        len(taps),
        from_x=as_double(np.concatenate([K, K_back @ T, direct @ T]).T),
        from_s=as_double(np.concatenate([K_back @ O, direct @ O]).T),
        from_z=as_double((chosen @ O_back).T),
        over_block=as_double(powers_of(A, length)[-1].T),
        steady=as_double(steady),
    )


def _placed(taps: Array, places: NDArray[np.intp], length: int) -> Wide:
    """Rows (taps places, L) that take taps (k, 9) about places of a block; places go fastest."""
    rows = np.zeros((len(taps), len(places), length), dtype=np.longdouble)
    for number, place in enumerate(places):
        rows[:, number, place - SIDE : place + SIDE + 1] = taps
    return rows.reshape(-1, length)
