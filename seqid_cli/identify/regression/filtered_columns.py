"""The filtered regressor of a long log, part by part, in the same memory.

The low-pass remembers: each part is computed and filtered with the samples on both sides of it.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base import Basis, base_regressor, loaded_columns
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


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
        Samples of a part, at most.
    reach : int
        Samples on either side that the filter remembers.
    """

    def __init__(self, equations: Columns, longest: int, reach: int) -> None:
        self._equations = equations
        self._reach = reach
        loaded = loaded_columns(equations.robot, equations.basis)
        loaded = np.pad(loaded, ((0, 0), (0, 1)))
        self._only = np.flatnonzero(loaded)
        # What is never written to is never given to the process.
        self._room = np.zeros((*loaded.shape, longest + 2 * reach))
        self._rows = self._room.reshape(loaded.size, -1)

    def of(self, motion: Motion, start: int, stop: int) -> Array:
        """Rows (stop - start, n, b + 1) of the next samples [start, stop), valid until the next.

        `motion` must hold as many samples on both sides as the filter remembers, where there are
        any.
        """
        low, high = max(0, start - self._reach), min(stop + self._reach, motion.samples)
        near, inner = motion.part(slice(low, high)), slice(start - low, stop - low)
        base_regressor(
            self._equations.robot,
            self._equations.basis,
            near.q,
            near.dq,
            near.ddq,
            spare=1,
            out=self._room,
        )
        filtered = self._rows[:, : near.samples]
        motion.lowpass.filter_rows(filtered, near.valid, only=self._only)
        H = self._room.transpose(2, 0, 1)[inner]
        H[:, :, -1] = self._equations.coupling_column(near)[inner]
        return H
