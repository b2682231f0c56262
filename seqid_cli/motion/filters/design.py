"""One pass of the Butterworth low-pass as a state space, also for every M-th sample of a log.

With poles p_i and residues r_i one pass is a sum of modes,

    H(z) = d + sum_i r_i / (z - p_i),

and each pair of conjugate modes is a state of two numbers that turns and decays. Unlike the states
of second-order sections these stay of the signal's size at any cut-off, so no digits cancel.

A Butterworth filter designed for every M-th sample by the bilinear transform is not the filter that
ran at the full rate: near its cut-off the two differ by what the frequency axis is bent. Terms
computed from decimated motion must see the filter that the torque has seen, so theirs has the
impulse response of the full rate's zero-phase filter at the kept samples,

    H(z) H(1/z):  h[k] = sum_i c_i p_i^|k|,      kept:  M h[M k] = sum_i M c_i (p_i^M)^|k|

(impulse invariance), again the response of a filter with poles p_i^M that is run forward and
backward; its zeros follow from the spectral factorisation of the numerator. Both responses differ
only by what lies above half of the kept rate, 3e-6 at ten samples per period of the cut-off.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import butter

from seqid_cli.typing import Array, Complex

Long = NDArray[np.clongdouble]

ORDER = 4


@dataclass(frozen=True)
class StateSpace:
    """A filter s+ = A s + B x, y = C s + D x of m states, with a gain of 1 at rest."""

    A: Array  # (m, m)
    B: Array  # (m,)
    C: Array  # (m,)
    D: float
    steady: Array  # (m,): the state at x = 1

    def twice(self) -> "StateSpace":
        """Two passes in the same direction."""
        A = np.block([[self.A, np.zeros_like(self.A)], [np.outer(self.B, self.C), self.A]])
        B = np.concatenate([self.B, self.B * self.D])
        C = np.concatenate([self.D * self.C, self.C])
        return StateSpace(A, B, C, self.D**2, np.concatenate([self.steady, self.steady]))


@lru_cache(maxsize=64)
def one_pass(cutoff_hz: float, rate_hz: float, every: int = 1) -> StateSpace:
    """Design one pass.

    `cutoff_hz`: of one pass. `every`: which sample of a log is filtered; the log has `every` times
    the rate.
    """
    zeros, poles, _ = butter(ORDER, cutoff_hz, fs=rate_hz * every, output="zpk")
    if every > 1:
        return _modes(*_decimated(np.asarray(poles, dtype=np.clongdouble), every))
    return _modes(np.asarray(zeros, np.complex128), np.asarray(poles, np.complex128))


def _modes(zeros: Complex, poles: Complex) -> StateSpace:
    """State space of as many zeros as poles, all of which are complex and single."""
    gain = float(np.real(np.prod(1 - poles) / np.prod(1 - zeros)))
    apart = poles[:, None] - poles
    np.fill_diagonal(apart, 1.0)
    residues = gain * np.prod(poles[:, None] - zeros, axis=1) / np.prod(apart, axis=1)
    upper = poles.imag > 0
    p, size = poles[upper], np.abs(1 - poles[upper])
    turns = [np.array([[z.real, -z.imag], [z.imag, z.real]]) for z in p]
    weights, steady = 2 * residues[upper] / size, size / (1 - p)
    return StateSpace(
        np.asarray(block_diag(*turns), dtype=np.float64),
        np.column_stack([size, np.zeros_like(size)]).ravel(),
        np.column_stack([weights.real, -weights.imag]).ravel(),
        gain,
        np.column_stack([steady.real, steady.imag]).ravel(),
    )


def _decimated(poles: Long, every: int) -> tuple[Complex, Complex]:
    """Zeros and poles of one pass at the kept samples."""
    apart = poles[:, None] - poles
    np.fill_diagonal(apart, 1.0)
    both = np.prod(apart, axis=1) * np.prod(1 - np.outer(poles, poles), axis=1)
    weights = (1 + poles) ** (2 * len(poles)) / (poles * both)  # c_i, up to one factor
    kept = poles**every
    zeros = _inner_roots(_numerator(weights * (1 - kept**2), kept))
    return np.append(zeros, 0.0), np.asarray(kept, dtype=np.complex128)


def _numerator(weights: Long, poles: Long) -> Array:
    """Numerator of sum_i w_i / ((1 - p_i / z) (1 - p_i z)) as a polynomial in z + 1 / z."""
    total = np.zeros(len(poles), dtype=np.clongdouble)
    for i, weight in enumerate(weights):
        term = np.array([weight])
        for p in np.delete(poles, i):
            term = np.convolve(term, np.array([-p, 1 + p**2]))
        total += term
    return np.asarray(total.real, dtype=np.float64)


def _inner_roots(numerator: Array) -> Complex:
    """For each root x of a polynomial the solution of z + 1 / z = x inside the unit circle."""
    roots = np.roots(numerator).astype(np.complex128)
    # On the unit circle a response has double zeros; rounding tears them apart where it is tiny.
    torn = (roots.imag == 0.0) & (np.abs(roots.real) < 2.0)
    half = np.where(torn, np.sign(roots.real), roots / 2)
    outer = np.sqrt(half - 1) * np.sqrt(half + 1)
    larger = np.where(np.abs(half + outer) >= 1.0, half + outer, half - outer)
    return np.asarray(1 / larger, dtype=np.complex128)
