"""The filtered regressor of a long log, part by part, in the same memory.

The low-pass remembers: what is filtered needs samples on both sides. Where no gap is near, the
state of its forward pass is carried from part to part, so that only what lies behind a part is
looked at twice, and every column is computed once. A part near a gap or an end of the log is
computed with the samples on its other side as well.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from seqid_cli.motion.block_filter import BlockLowpass
from seqid_cli.motion.blocks import part_of
from seqid_cli.motion.filtering import runs
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base import Basis, base_regressor, loaded_columns
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]


class Columns(Protocol):
    """What the columns are of."""

    robot: Robot
    basis: Basis

    def coupling_column(self, motion: Motion) -> Array:
        """One more column (N, n), filtered."""
        ...


class FilteredColumns:
    """Filtered base regressors and coupling columns of consecutive parts of one log.

    Parameters
    ----------
    equations : Columns
    longest : int
        Samples of a part, at most. All but the last must have a multiple of `block_filter.STEP`.
    reach : int
        Samples on either side that the filter remembers.
    """

    def __init__(self, equations: Columns, longest: int, reach: int) -> None:
        self._equations = equations
        self._reach = reach
        loaded = loaded_columns(equations.robot, equations.basis)
        loaded = np.pad(loaded, ((0, 0), (0, 1)))
        self._only = np.flatnonzero(loaded)
        self._spans = runs(loaded.ravel(), loaded.size)
        # What is never written to is never given to the process.
        self._room = np.zeros((*loaded.shape, longest + 2 * reach))
        self._rows = self._room.reshape(loaded.size, -1)
        self._states: Array | None = None  # of the forward pass behind the last part
        self._ahead = 0  # where the columns of the samples behind it lie, not filtered

    def of(self, motion: Motion, start: int, stop: int) -> Array:
        """Rows (stop - start, n, b + 1) of the next samples [start, stop), valid until the next.

        `motion` must hold as many samples on both sides as the filter remembers, where there are
        any.
        """
        end = stop + self._reach
        low, high = max(0, start - self._reach), min(end, motion.samples)
        lowpass = motion.lowpass
        assert isinstance(lowpass, BlockLowpass)
        goes_on = end == high and bool(motion.valid[start:end].all())
        if goes_on and self._states is not None:
            first = 0
            self._go_on(motion, lowpass, start, stop)
        else:
            first = start - low
            goes_on &= stop - low >= self._reach and bool(motion.valid[low:start].all())
            goes_on &= lowpass.can_go_on()
            self._begin(part_of(motion, low, high), lowpass, stop - low, goes_on=goes_on)
        H = self._room.transpose(2, 0, 1)[first : first + stop - start]
        coupling = self._equations.coupling_column(part_of(motion, low, high))
        H[:, :, -1] = coupling[start - low : stop - low]
        return H

    def _go_on(self, motion: Motion, lowpass: BlockLowpass, start: int, stop: int) -> None:
        """Filter the part [start, stop), and fill in what lies behind it."""
        assert self._states is not None
        reach, rows, ahead = self._reach, self._rows, self._ahead
        for a, b in self._spans:
            rows[a:b, :reach] = rows[a:b, ahead : ahead + reach]
        self._fill(part_of(motion, start + reach, stop + reach), reach)
        lowpass.filter_on(
            rows,
            stop - start + reach,
            stop - start,
            self._states,
            only=self._only,
        )
        self._ahead = stop - start

    def _begin(self, near: Motion, lowpass: BlockLowpass, stop: int, *, goes_on: bool) -> None:
        """Filter samples with those on both sides, of which the part ends at `stop`."""
        self._fill(near, 0)
        rows, reach = self._rows, self._reach
        self._states, self._ahead = None, stop
        if goes_on:
            behind = [rows[a:b, stop : stop + reach].copy() for a, b in self._spans]
            before = rows[self._only, stop - reach : stop]
            self._states = lowpass.state_behind(before)
        valid = np.zeros(rows.shape[1], dtype=np.bool_)
        valid[: near.samples] = near.valid
        lowpass.filter_rows(rows, valid, only=self._only)
        if goes_on:
            for (a, b), columns in zip(self._spans, behind, strict=True):
                rows[a:b, stop : stop + reach] = columns

    def _fill(self, motion: Motion, first: int) -> None:
        """Compute columns of samples and put them behind the first ones."""
        base_regressor(
            self._equations.robot,
            self._equations.basis,
            motion.q,
            motion.dq,
            motion.ddq,
            spare=1,
            out=self._room,
            first=first,
        )
