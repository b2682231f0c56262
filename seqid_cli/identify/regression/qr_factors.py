"""Triangular factors of rows [H y], in the two ways that are fast enough.

By Householder reflections (LAPACK's `dtpqrt`), whatever the rows. Or, with the factor R0 of earlier
rows, from the Gram matrix of the new ones seen in its coordinates (preconditioned Cholesky QR;
compare Y. Yamamoto et al., Electron. Trans. Numer. Anal. 44 (2015) 306):

    B = A R0^-1,    G = B'B = L L',    R = L' R0,    R'R = A'A.

What is rounded in G is rounded against R0'R0, in every direction: against what is known already, as
the earlier rows stay in the sum. It is small while G is not large (`LARGEST`) and R0^-1 can be
multiplied with (`CONDITION`); where one of the two fails, or a column lives in only one of A and
R0, the rows are reduced by reflections, and they join R0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk, dtrmm
from scipy.linalg.lapack import dpotrf, dtpqrt, dtrtri

from seqid_cli.typing import Array, Index, Mask

Spans = list[tuple[int, int]]  # half-open ranges of rows

PANEL = 8  # columns that the blocked QR takes at once
STRIP = 1024  # rows that it takes at once: they stay in cache
ENOUGH = 3  # rows per column from which the Gram matrix is cheaper
LARGEST = 1e3  # trace of G
LARGEST_WHOLE = 1e5  # where R0'R0 is part of it, so that no direction of G is small
CONDITION = 1e5  # of R0, whatever the scale of its columns
WELL = 100.0  # its square costs no digits that matter
EPS = float(np.finfo(np.float64).eps)


def triangular(rows: Array) -> Array:
    """Triangular factor (p, p) of rows (N, p), diagonal not negative.

    Columns of zeros give columns and rows of zeros.
    """
    H, y = rows[:, :-1], rows[:, -1]
    return by_reflections(H, y, not_zero(H, y))


def not_zero(H: Array, y: Array, loaded: Mask | None = None, spans: Spans | None = None) -> Mask:
    """Columns (p + 1,) of [H y] that are not all zero; only `loaded` ones (p,) are looked at.

    With `spans` of H, y holds the rows of these alone.
    """
    alive = np.zeros(H.shape[1] + 1, dtype=np.bool_)
    if not len(y):
        return alive
    first = H[0] if spans is None else H[spans[0][0]]
    alive[:-1], alive[-1] = first != 0.0, y.any()  # most show it in their first row
    rest = ~alive[:-1] if loaded is None else loaded & ~alive[:-1]
    if rest.any():
        for start, stop in _runs(np.flatnonzero(rest)):
            for low, high in spans or [(0, len(H))]:
                part = H[low:high, start:stop]
                alive[start:stop] |= (part.max(axis=0) != 0.0) | (part.min(axis=0) != 0.0)
    return alive


def spans_of(where: Mask) -> Spans:
    """Ranges of rows in which a mask (N,) is true."""
    edges = np.flatnonzero(where[1:] != where[:-1]) + 1
    ends = [0, *edges.tolist(), len(where)]
    first = 0 if where[0] else 1
    return list(zip(ends[first:-1:2], ends[first + 1 :: 2], strict=True))


def by_reflections(H: Array, y: Array, alive: Mask, spans: Spans | None = None) -> Array:
    """Factor (p + 1, p + 1) of rows [H y], (N, p) and (N,), of which some columns are not zero.

    With `spans` of H, y holds the rows of these alone.
    """
    chosen, runs = np.flatnonzero(alive), _runs(np.flatnonzero(alive[:-1]))
    R = np.zeros((len(chosen), len(chosen)), order="F")
    if spans is not None and len(chosen):
        rows = np.empty((len(chosen), len(y)))
        _lay(rows, H.T, y, runs, spans)
        for start in range(0, len(y), STRIP):
            R = _reflected(R, np.ascontiguousarray(rows[:, start : start + STRIP]).T, 0)
        return _signed(R, chosen, len(alive))
    for start in range(0, len(y) if len(chosen) else 0, STRIP):
        part = slice(start, start + STRIP)
        strip = np.empty((len(chosen), len(y[part])))
        _lay(strip, H[part].T, y[part], runs)
        R = _reflected(R, strip.T, 0)
    return _signed(R, chosen, len(alive))


def merged(first: Array, second: Array) -> Array:
    """Factor of the rows that two factors stand for."""
    alive = np.flatnonzero(first.any(axis=0) | second.any(axis=0))
    if not len(alive):
        return first
    R, below = (np.asfortranarray(factor[alive[:, None], alive]) for factor in (first, second))
    return _signed(_reflected(R, below, len(alive)), alive, len(first))


def merged_pairs(factors: list[Array]) -> list[Array]:
    """Merge each two neighbours; one without a partner stays."""
    pairs = [merged(*factors[i : i + 2]) for i in range(0, len(factors) - 1, 2)]
    return pairs + factors[2 * len(pairs) :]


@dataclass(frozen=True)
class Coordinates:
    """The factor R0 of some rows as coordinates for others, on the columns that are not zero.

    `inverse` is None where it cannot be used. Where R0 is `well` conditioned, columns may stay as
    they are, and only y is seen without what R0 makes of them.
    """

    factor: Array  # (p + 1, p + 1)
    alive: Mask  # (p + 1,) columns that are not zero, k of them
    R: Array  # (k, k)
    inverse: Array | None
    well: bool
    runs: list[tuple[int, int]]  # of alive columns, without y

    @classmethod
    def of(cls, factor: Array) -> Coordinates:
        """Coordinates of the rows that a factor stands for."""
        alive: Mask = np.asarray(factor.any(axis=0))
        chosen = np.flatnonzero(alive)
        R = np.asfortranarray(factor[chosen[:, None], chosen])
        inverse, condition = _inverse(R)
        well = condition <= WELL and bool(alive[-1])
        usable = inverse if condition <= CONDITION else None
        return cls(factor, alive, R, usable, well, _runs(np.flatnonzero(alive[:-1])))

    def joined(self, factor: Array) -> Coordinates:
        """Coordinates of these rows and others."""
        return Coordinates.of(merged(self.factor, factor))

    def reduced(
        self,
        H: Array,
        y: Array,
        alive: Mask,
        *,
        whole: bool = False,
        spans: Spans | None = None,
    ) -> Array | None:
        """Factor of rows [H y]; None where it must be found by reflections.

        `whole` says that those which R0 stands for are among them. With `spans` of H, y holds the
        rows of these alone.
        """
        few = len(y) < ENOUGH * len(self.R)
        if self.inverse is None or few or (alive != self.alive).any():
            return None
        largest = LARGEST_WHOLE if whole else LARGEST
        R = self._by_columns(*self._laid(H, y, spans), largest) if self.well else None
        if R is None:
            R = self._by_products(*self._laid(H, y, spans), largest)
        if R is None or len(R) == len(alive):
            return R
        return _in_full(R, np.flatnonzero(alive), len(alive))

    def _by_products(self, B: Array, across: bool, largest: float) -> Array | None:
        """R = L' R0 from B R0^-1, B = [H y] being used up."""
        B = dtrmm(1.0, self.inverse, B, side=int(not across), trans_a=int(across), overwrite_b=True)
        G = dsyrk(1.0, B, trans=int(not across))
        size = float(G.trace())
        L = _root(G, size) if size <= largest else None
        return None if L is None else np.ascontiguousarray(dtrmm(1.0, L, self.R))

    def _by_columns(self, B: Array, across: bool, largest: float) -> Array | None:
        """R = L' [I x; 0 1] from [H  y - H x], x being the solution of R0; B = [H y] is used up."""
        inverse = self.inverse
        assert inverse is not None
        x = -inverse[:-1, -1] / inverse[-1, -1]
        last, others = (B[-1], B[:-1].T) if across else (B[:, -1], B[:, :-1])
        last -= others @ x
        L, failed = dpotrf(dsyrk(1.0, B, trans=int(not across)), clean=True)
        if failed:
            return None
        L[:, -1] += L[:, :-1] @ x
        size = float(np.linalg.norm(dtrmm(1.0, inverse, L, side=1)) ** 2)
        return np.ascontiguousarray(L) if size <= largest else None

    def _laid(self, H: Array, y: Array, spans: Spans | None) -> tuple[Array, bool]:
        """[H y] without columns of zeros, (N, k) and False; as (k, N) and True, to be cheaper.

        Fortran-ordered. To turn round what lies in memory sample by sample costs as much as R.
        """
        across = H.strides[0] > H.strides[1]
        rows = np.empty((len(y), len(self.R)) if across else (len(self.R), len(y)))
        _lay(rows.T if across else rows, H.T, y, self.runs, spans)
        return rows.T, across


def _inverse(R: Array) -> tuple[Array | None, float]:
    """R^-1 and the condition that tells how good products with it are.

    It does not depend on the scale of columns. The last column counts for nothing: an error in it,
    the right side's, stays in it.
    """
    if not len(R):
        return None, np.inf
    inverse, failed = dtrtri(R)
    if failed or not np.isfinite(inverse).all():
        return None, np.inf
    inner = np.abs(R[:-1, :-1]) @ np.abs(inverse[:-1, :-1])
    return np.asfortranarray(inverse), float(inner.max(initial=0.0))


def _root(G: Array, size: float) -> Array | None:
    """Upper triangular root of G; of G and its rounding errors where it has less than full rank."""
    for shift in (0.0, 4.0 * EPS * size, 4.0 * EPS * size * len(G)):
        root, failed = dpotrf(G + shift * np.eye(len(G)) if shift else G, clean=True)
        if not failed:
            return np.asarray(root)
    return None


def _lay(
    out: Array, columns: Array, y: Array, runs: list[tuple[int, int]], spans: Spans | None = None
) -> None:
    """Put runs of columns (p, N), and y if there is room, into out (k, M); of all N or of spans."""
    to = 0
    for start, stop in runs:
        target, part = out[to : to + stop - start], columns[start:stop]
        if spans is None:
            target[:] = part
        else:
            at = 0
            for low, high in spans:
                target[:, at : at + high - low] = part[:, low:high]
                at += high - low
        to += stop - start
    out[to:] = y


def _runs(numbers: Index) -> Spans:
    """Half-open ranges of consecutive ones among ascending numbers."""
    if not len(numbers):
        return []
    ends = np.flatnonzero(numbers[1:] - numbers[:-1] > 1)
    starts = [int(numbers[0]), *numbers[ends + 1].tolist()]
    stops = [*(numbers[ends] + 1).tolist(), int(numbers[-1]) + 1]
    return list(zip(starts, stops, strict=True))


def _reflected(R: Array, rows: Array, triangle: int) -> Array:
    """R (k, k) of R on top of rows (m, k), the last `triangle` of them upper trapezoidal.

    Both must be Fortran-ordered and are used up.
    """
    panel = min(PANEL, len(R))
    R, *_ = dtpqrt(triangle, panel, R, rows, overwrite_a=True, overwrite_b=True)
    return R


def _signed(R: Array, chosen: Index, size: int) -> Array:
    """R of the chosen columns in a factor (size, size) with no negative entry on its diagonal."""
    flipped = np.flatnonzero(R.diagonal() < 0)
    R[flipped] *= -1.0
    return _in_full(np.ascontiguousarray(R), chosen, size)


def _in_full(R: Array, chosen: Index, size: int) -> Array:
    if len(chosen) == size:
        return R
    full = np.zeros((size, size))
    full[chosen[:, None], chosen] = R
    return full
