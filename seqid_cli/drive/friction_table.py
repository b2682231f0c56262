"""Friction of one joint for either direction, on a grid of positions and speeds."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.raw import Rows
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.typing import Array

# Torque (B,) N m that effects add at positions, speeds and a direction of motion.
AddedFriction = Callable[[Array, Array, float], Array]

# Widths of the sign over which friction changes sides: beyond them it is whole.
FULL_WIDTHS = 5.0
POSITIONS = 33  # of the friction tables
SPEEDS = 65


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
        cls,
        surface: FrictionSurface | None,
        low: float,
        high: float,
        fastest: float,
        added: AddedFriction | None = None,
    ) -> "FrictionTable":
        """Fill the table over some positions, up to a speed; `added` is by effects."""
        positions = np.linspace(low, high, POSITIONS)
        speeds = np.linspace(0.0, fastest, SPEEDS)
        shape = (POSITIONS, SPEEDS)
        q = np.repeat(positions, SPEEDS)
        forward = np.zeros(len(q))
        backward = np.zeros(len(q))
        if surface is not None:
            full = np.maximum(speeds, FULL_WIDTHS * surface.sign_width)
            v = np.tile(full, POSITIONS)
            forward = surface.torque(q, v)
            backward = surface.torque(q, -v)
        if added is not None:
            v = np.tile(speeds, POSITIONS)
            forward = forward + added(q, v, 1.0)
            backward = backward + added(q, -v, -1.0)
        return cls(positions, speeds, forward.reshape(shape), backward.reshape(shape))

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


def _place(grid: Array, values: Array) -> tuple[Rows, Array]:
    """Return the cell of each value on an even grid, and the place in it, 0 to 1."""
    place = (values - grid[0]) / (grid[1] - grid[0])
    place = np.clip(place, 0.0, len(grid) - 1.000001)
    cell: Rows = place.astype(np.intp)
    return cell, np.asarray(place - cell)
