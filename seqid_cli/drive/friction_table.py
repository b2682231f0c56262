"""Friction of one joint for either direction, on a grid of positions and speeds."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.drive.signals import DriveSignals
from seqid_cli.logs.raw import Rows
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.typing import Array

# Widths of the sign over which friction changes sides: beyond them it is whole.
FULL_WIDTHS = 5.0
POSITIONS = 33  # of the friction tables
SPEEDS = 65
# Beyond the positions and speeds of the log, as a share of them, to which friction is
# tabled: a simulated joint overshoots where the real one did not.
MARGIN = 0.2


@dataclass
class FrictionTable:
    """Friction of one joint for either direction, on a grid of positions and speeds.

    A surface is a polynomial that costs much to evaluate at every step.
    """

    positions: Array
    speeds: Array
    forward: Array = field(repr=False)  # (POSITIONS, SPEEDS) N m
    backward: Array = field(repr=False)

    @classmethod
    def of(
        cls, surface: FrictionSurface | None, low: float, high: float, fastest: float
    ) -> "FrictionTable":
        """Fill the table over some positions, up to a speed."""
        positions = np.linspace(low, high, POSITIONS)
        speeds = np.linspace(0.0, fastest, SPEEDS)
        if surface is None:
            nothing = np.zeros((POSITIONS, SPEEDS))
            return cls(positions, speeds, nothing, nothing)
        full = np.maximum(speeds, FULL_WIDTHS * surface.sign_width)
        q = np.repeat(positions, SPEEDS)
        v = np.tile(full, POSITIONS)
        shape = (POSITIONS, SPEEDS)
        return cls(
            positions,
            speeds,
            surface.torque(q, v).reshape(shape),
            surface.torque(q, -v).reshape(shape),
        )

    def limits(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (B,) N m."""
        i, x = _place(self.positions, q)
        k, y = _place(self.speeds, np.abs(v))

        def at(table: Array) -> Array:
            before = table[i, k] * (1.0 - y) + table[i, k + 1] * y
            after = table[i + 1, k] * (1.0 - y) + table[i + 1, k + 1] * y
            return np.asarray(before * (1.0 - x) + after * x)

        low = at(self.backward)
        high = at(self.forward)
        return np.minimum(low, high), np.maximum(low, high)


def table_for(
    surface: FrictionSurface | None, logs: Sequence[DriveSignals], joint: int
) -> FrictionTable:
    """Fill the table of a joint for the range of some logs, and a margin."""
    q = np.concatenate([log.q[:, joint] for log in logs])
    fastest = max(float(np.abs(log.dq[:, joint]).max()) for log in logs)
    margin = MARGIN * max(float(np.ptp(q)), 1e-3)
    return FrictionTable.of(
        surface,
        float(q.min()) - margin,
        float(q.max()) + margin,
        (1.0 + 2.0 * MARGIN) * max(fastest, 1e-3),
    )


def _place(grid: Array, values: Array) -> tuple[Rows, Array]:
    """Return the cell of each value on an even grid, and the place in it, 0 to 1."""
    place = (values - grid[0]) / (grid[1] - grid[0])
    place = np.clip(place, 0.0, len(grid) - 1.000001)
    cell: Rows = place.astype(np.intp)
    return cell, np.asarray(place - cell)
