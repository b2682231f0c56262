"""The zero-phase low-pass as matrix products: the same filter, several times cheaper.

A recursive filter with state s (m,), s+ = A s + B x, y = C s + D x, taken over blocks of L samples,

    y = T x + O s,      s after the block = A^L s + K x,

T (L, L) being the Toeplitz matrix of its impulse response, O = [C; C A; ...] and
K = [A^(L-1) B ... B] (block realisation of recursive filters, C. S. Burrus, IEEE Trans. Audio
Electroacoust. 20 (1972) 230). Run backwards, with state z, the matrices are the same ones mirrored
(T', O', K'), and both ways together are one product,

    y = T' (T x + O s) + O' z,      z before the block = A^L z + K' (T x + O s).

Only the states go step by step. The state space is that of the cascade of second-order sections, so
it is as well conditioned as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm
from scipy.signal import sosfilt, sosfilt_zi

from seqid_cli.motion.filtering import ORDER, SHORTEST, Lowpass, runs, sections

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Wide = NDArray[np.longdouble]

STATES = ORDER
LENGTH = 32  # samples per block: longer ones cost more products, shorter ones more steps
GROUP = 16  # blocks whose states are found together
STEP = 64  # samples: whole blocks of both ways to go on
NEGLIGIBLE = 1e-13
REACH = 64  # samples more than the memory, for what grows before it decays
# Of the rate: below, what rounding leaves in the states of blocks exceeds 1e-12 of the signal.
LOWEST = 0.0025 if np.finfo(np.longdouble).eps < 1e-18 else 0.006
TILE = 131_072  # values filtered together: what is made on the way stays in cache


class BlockLowpass(Lowpass):
    """A `Lowpass` that gives the same values, to rounding, by matrix products."""

    @property
    def memory(self) -> int:
        """Samples after which one pass of the filter has forgotten what was before (to 1e-13)."""
        if not self.active:
            return 0
        return _kernel(self.cutoff_hz, self.rate_hz, self.every).memory

    def __call__(self, values: Array, valid: Mask | None = None) -> Array:
        """Filter along the first axis, as `Lowpass` does."""
        rows = np.array(values.reshape(len(values), -1).T, order="C")
        self.filter_rows(rows, valid)
        return np.ascontiguousarray(rows.T).reshape(values.shape)

    def filter_rows(
        self,
        rows: Array,
        valid: Mask | None = None,
        *,
        only: NDArray[np.intp] | None = None,
    ) -> None:
        """Filter signals in place, samples last, each run of valid samples by itself.

        Parameters
        ----------
        rows : (c, N) array
        valid : (N,) bool array, optional
            False where samples must not leak into others; these stay as they are.
        only : array of int, optional
            Numbers of the signals to filter; all by default.
        """
        if not self.active:
            return
        if self.cutoff_hz < LOWEST * self.rate_hz:
            chosen = slice(None) if only is None else only
            rows[chosen] = super().__call__(rows[chosen].T, valid).T
        else:
            self._filter_blocks(rows, valid, only)

    def can_go_on(self) -> bool:
        """Whether `filter_on` serves."""
        return self.active and self.cutoff_hz >= LOWEST * self.rate_hz

    def state_behind(self, rows: Array) -> Array:
        """State (c, 4) of the forward pass behind signals (c, N), as long as the memory."""
        sos = sections(self.cutoff_hz, self.rate_hz, self.every)
        steady = sosfilt_zi(sos)[:, None] * rows[None, :, :1]
        _, state = sosfilt(sos, rows, axis=1, zi=steady)
        return np.ascontiguousarray(state.transpose(1, 0, 2)).reshape(len(rows), STATES)

    def filter_on(
        self,
        rows: Array,
        stop: int,
        count: int,
        states: Array,
        *,
        only: NDArray[np.intp],
    ) -> None:
        """Filter the next samples of signals that go on, in place; see `can_go_on`.

        What lies before the samples is in the state of the forward pass, so that only those behind
        them are looked at anew when it is their turn.

        Parameters
        ----------
        rows : (c, N) array, C-ordered
        stop : int
            Samples that are known: as many more than `count` as the filter remembers.
        count : int
            Samples to filter, from the first one on: a multiple of `STEP`, but for the last time.
        states : (k, 4) array, C-ordered
            In front of the first sample; behind the last one filtered on return.
        only : (k,) array
            Numbers of the signals to filter, ascending.
        """
        kernel = _kernel(self.cutoff_hz, self.rate_hz, self.every)
        height = max(1, TILE // stop)
        room = _Room.of(min(height, len(only)), stop)
        for first, last in _consecutive(only, height):  # without copies
            part = slice(only[first], only[first] + last - first)
            kernel.on_both_ways(rows[part, :stop], count, states[first:last], room)

    def _filter_blocks(
        self, rows: Array, valid: Mask | None, only: NDArray[np.intp] | None
    ) -> None:
        kernel = _kernel(self.cutoff_hz, self.rate_hz, self.every)
        count = len(rows) if only is None else len(only)
        for start, stop in runs(valid, rows.shape[1]):
            if stop - start > SHORTEST:
                pad = min(6 * self.settling, stop - start - 1)
                height = max(1, TILE // (stop - start))
                room = _Room.of(min(height, count), stop - start + 2 * pad)
                for top in range(0, count, height):
                    part = slice(top, top + height)
                    if only is None:
                        kernel.both_ways(rows[part, start:stop], pad, room)
                    else:
                        taken = rows[only[part], start:stop]
                        kernel.both_ways(taken, pad, room)
                        rows[only[part], start:stop] = taken


def _consecutive(numbers: NDArray[np.intp], most: int) -> Iterator[tuple[int, int]]:
    """Yield ranges of ascending numbers that follow each other, up to so many."""
    ends = [0, *(np.flatnonzero(np.diff(numbers) > 1) + 1).tolist(), len(numbers)]
    for first, last in pairwise(ends):
        for low in range(first, last, most):
            yield low, min(low + most, last)


@dataclass(frozen=True)
class _Room:
    """Arrays used again and again: fresh memory costs as much as the filter."""

    wide: Array  # (c, b LENGTH): samples, b whole groups of blocks
    out: Array  # (c b, LENGTH)
    added: Array  # (c b, 2 m): what each block adds to both states
    states: Array  # (c b, 2 m): both states before each block

    @classmethod
    def of(cls, channels: int, length: int) -> _Room:
        """Make room for signals (channels, length)."""
        count = -(-length // (LENGTH * GROUP)) * GROUP
        return cls(
            np.empty((channels, count * LENGTH)),
            np.empty((channels * count, LENGTH)),
            np.empty((channels * count, 2 * STATES)),
            np.empty((channels * count, 2 * STATES)),
        )

    def part(self, channels: int) -> _Room:
        """The room of the first signals only."""
        count = channels * (self.wide.shape[1] // LENGTH)
        return _Room(
            self.wide[:channels], self.out[:count], self.added[:count], self.states[:count]
        )


@dataclass(frozen=True)
class _Steps:
    """What a group's blocks add (GROUP m,) to the states in it, in one direction."""

    within: Array  # (GROUP m, GROUP m): to the state before each block
    after: Array  # (GROUP m, m): to the state behind the group
    entering: Array  # (m, GROUP m): the state in front of the group to that before each block

    @classmethod
    def of(cls, powers: Array, *, back: bool) -> _Steps:
        """Lay out the powers (GROUP + 1, m, m) of one block's step."""
        within = np.zeros((GROUP, STATES, GROUP, STATES))
        for j in range(GROUP):
            for k in range(j) if back else range(j + 1, GROUP):
                within[j, :, k] = powers[abs(k - j) - 1]
        after = powers[:GROUP] if back else powers[GROUP - 1 :: -1]
        entering = np.concatenate(powers[GROUP - 1 :: -1] if back else powers[:GROUP], axis=1)
        return cls(within.reshape(GROUP * STATES, -1), after.reshape(-1, STATES), entering)


@dataclass(frozen=True)
class _Kernel:
    """Block matrices of one filter, transposed; see the module's text."""

    both: Array  # (L + 2 m, L): x, s, z to y
    adds: Array  # (L, 2 m): x to what it adds to s and z
    passed: Array  # (m, m): s to what it adds to z
    last: Array  # (L + m,): x, s to the last sample of one pass
    over_group: Array  # (m, m): A^(L GROUP), transposed
    ahead: _Steps
    back: _Steps
    steady: Array  # (m,) state at x = 1
    memory: int

    def both_ways(self, rows: Array, pad: int, room: _Room) -> None:
        """Filter (c, N) in place, forward and backward, prolonged by point reflection."""
        channels, count = rows.shape
        room = room.part(channels)
        _lay(rows, pad, room.wide)
        # What lies in front of the signal is its first value: the filter starts in steady state.
        self._fill_out(room, room.wide[:, :1] * self.steady)
        wide = room.out.reshape(channels, -1)
        stop = wide.shape[1] - pad
        rows[:] = wide[:, stop - count : stop]

    def on_both_ways(self, rows: Array, count: int, start: Array, room: _Room) -> None:
        """Filter the first samples of (c, N) in place, from a state (c, m) to the one behind."""
        channels, known = rows.shape
        room = room.part(channels)
        room.wide[:, :known] = rows
        room.wide[:, known:] = rows[:, -1:]
        self._fill_out(room, start)
        rows[:, :count] = room.out.reshape(channels, -1)[:, :count]
        if count < known:
            start[:] = room.states.reshape(channels, -1, 2 * STATES)[:, count // LENGTH, :STATES]

    def _fill_out(self, room: _Room, start: Array) -> None:
        """Filter what is laid in a room, from a state (c, m)."""
        channels = len(start)
        x, states = room.wide.reshape(-1, LENGTH), room.states
        np.matmul(x, self.adds, out=room.added)
        states[:, :STATES] = self._states(self.ahead, room.added[:, :STATES], start)
        room.added[:, STATES:] += states[:, :STATES] @ self.passed
        ends = room.wide[:, -LENGTH:] @ self.last[:LENGTH]
        ends += states.reshape(channels, -1, 2 * STATES)[:, -1, :STATES] @ self.last[LENGTH:]
        states[:, STATES:] = self._states(
            self.back, room.added[:, STATES:], ends[:, None] * self.steady
        )
        np.matmul(x, self.both[:LENGTH], out=room.out)
        dgemm(1.0, self.both[LENGTH:].T, states.T, 1.0, room.out.T, overwrite_c=True)

    def _states(self, steps: _Steps, added: Array, start: Array) -> Array:
        """States (c b, m) before each block, from the start (c, m) and what each block adds."""
        grouped = np.ascontiguousarray(added).reshape(-1, GROUP * STATES)
        grown = (grouped @ steps.after).reshape(len(start), -1, STATES)
        ahead = steps is self.ahead
        before = scanned(start, grown if ahead else grown[:, ::-1], self.over_group)
        before = before if ahead else before[:, ::-1]
        found = grouped @ steps.within
        found += before.reshape(-1, STATES) @ steps.entering
        return found.reshape(-1, STATES)


def scanned(start: Array, added: Array, step: Array) -> Array:
    """States x (..., b, m) before each of b steps x+ = x step + added (..., b, m), by doubling."""
    states = np.concatenate([start[..., None, :], added[..., :-1, :]], axis=-2)
    distance = 1
    while distance < states.shape[-2] and np.abs(step).max() > NEGLIGIBLE**2:
        states[..., distance:, :] += states[..., :-distance, :] @ step
        step, distance = step @ step, 2 * distance
    return states


def _lay(rows: Array, pad: int, wide: Array) -> None:
    """Put signals (c, N) and their reflections at the end, the first value before."""
    stop = wide.shape[1] - pad
    start = stop - rows.shape[1]
    wide[:, start:stop] = rows
    np.subtract(2 * rows[:, :1], rows[:, pad:0:-1], out=wide[:, start - pad : start])
    np.subtract(2 * rows[:, -1:], rows[:, -2 : -2 - pad : -1], out=wide[:, stop:])
    wide[:, : start - pad] = wide[:, start - pad, None]


@lru_cache(maxsize=64)
def _kernel(cutoff_hz: float, rate_hz: float, every: int) -> _Kernel:
    """Build the matrices, in the longest floating point there is: low cut-offs cancel digits."""
    design = sections(cutoff_hz, rate_hz, every).astype(np.longdouble)
    A, B, C, D, steady = state_space(design)
    T, O, K = block_matrices(A, B, C, D, LENGTH)
    T_back, O_back, K_back = T.T, O[::-1], K[:, ::-1]
    over_block = powers_of(A, LENGTH)[-1]
    powers = as_double(np.array([power.T for power in powers_of(over_block, GROUP)]))
    slowest = float(np.abs(np.linalg.eigvals(as_double(A))).max())
    return _Kernel(
        both=as_double(np.concatenate([(T_back @ T).T, (T_back @ O).T, O_back.T])),
        adds=as_double(np.concatenate([K, K_back @ T]).T),
        passed=as_double((K_back @ O).T),
        last=as_double(np.concatenate([T[-1], O[-1]])),
        over_group=powers[GROUP],
        ahead=_Steps.of(powers, back=False),
        back=_Steps.of(powers, back=True),
        steady=as_double(steady),
        memory=int(np.ceil(np.log(NEGLIGIBLE) / np.log(slowest))) + 1,
    )


def block_matrices(
    A: Wide, B: Wide, C: Wide, D: np.longdouble, length: int
) -> tuple[Wide, Wide, Wide]:
    """T (L, L), O (L, m) and K (m, L) of a block of L samples; see the module's text."""
    responses, steps, rows = [D], [B], [C]
    for _ in range(length - 1):
        responses.append(np.longdouble(C @ steps[-1]))
        steps.append(A @ steps[-1])
        rows.append(rows[-1] @ A)
    delay = np.subtract.outer(np.arange(length), np.arange(length))
    T = np.where(delay >= 0, np.array(responses)[np.maximum(delay, 0)], 0.0)
    return T, np.array(rows), np.array(steps[::-1]).T


def powers_of(A: Wide, highest: int) -> list[Wide]:
    """A^0 ... A^highest; `matrix_power` and BLAS know no long floating point."""
    found = [np.eye(len(A), dtype=np.longdouble)]
    for _ in range(highest):
        found.append(found[-1] @ A)
    return found


def as_double(values: Wide) -> Array:
    """The same in double precision, row by row in memory."""
    return np.ascontiguousarray(values, dtype=np.float64)


def state_space(sections: Wide) -> tuple[Wide, Wide, Wide, np.longdouble, Wide]:
    """A, B, C, D of sections in the transposed direct form II, and the state at x = 1."""
    empty = np.zeros(0, dtype=np.longdouble)
    A, B, C, D = empty.reshape(0, 0), empty, empty, np.longdouble(1.0)
    steady, level = [empty], np.longdouble(1.0)
    for b0, b1, b2, _, a1, a2 in sections:
        own = np.array([[-a1, 1.0], [-a2, 0.0]], dtype=np.longdouble)
        drive = np.array([b1 - a1 * b0, b2 - a2 * b0])
        corner = np.zeros((len(A), 2), dtype=np.longdouble)
        A = np.block([[A, corner], [np.outer(drive, C), own]])
        B = np.concatenate([B, drive * D])
        C = np.concatenate([b0 * C, np.array([1.0, 0.0], dtype=np.longdouble)])
        D = D * b0
        out = level * (b0 + b1 + b2) / (1.0 + a1 + a2)
        steady.append(np.array([out - b0 * level, b2 * level - a2 * out]))
        level = out
    return A, B, C, D, np.concatenate(steady)
