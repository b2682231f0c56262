"""Friction of one joint for either direction, on a grid of positions and speeds."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.raw import Rows
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.typing import Array

# Torque (B,) N m that effects add at positions, speeds and a direction of motion.
AddedFriction = Callable[[Array, Array, float], Array]

# Widths of the sign, at which friction's sign is a share of it that is known well.
LEAST_WIDTHS = 0.1
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
            # At rest a surface has no sign: it is taken where it has a little of one.
            some = np.maximum(speeds, LEAST_WIDTHS * surface.sign_width)
            v = np.tile(some, POSITIONS)
            ahead = surface.torque(q, v)
            back = surface.torque(q, -v)
            whole = 0.5 * (ahead - back) / np.tanh(v / surface.sign_width)
            offset = 0.5 * (ahead + back)
            forward = offset + whole
            backward = offset - whole
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

    def along(self, q: Array) -> "FrictionAlong":
        """Return friction at positions (T, B) that are known before."""
        sides = np.stack(
            [
                np.minimum(self.backward, self.forward),
                np.maximum(self.backward, self.forward),
            ],
            axis=-1,
        )
        slopes = np.diff(sides, axis=1, append=sides[:, -1:])
        cell, part = _place(self.positions, q)
        return FrictionAlong(
            per_speed=float(1.0 / (self.speeds[1] - self.speeds[0])),
            cells=np.concatenate([sides, slopes], axis=-1).reshape(-1, 4),
            first=SPEEDS * cell,
            part=part[..., None],
            is_even=bool(np.ptp(sides, axis=0).max(initial=0.0) == 0.0),
        )


@dataclass(frozen=True, kw_only=True)
class FrictionAlong:
    """Friction over the speed at T times of B windows, where positions are known.

    Attributes
    ----------
    per_speed : float
        s/rad, cells of the table.
    cells : (POSITIONS * SPEEDS, 4) array
        N m, the least and the largest friction, and what the next speed has more.
    first : (T, B) array
        Number of the first speed at the position before.
    part : (T, B, 1) array
        Place between the position before and the one behind, 0 to 1.
    is_even : bool
        Whether friction is the same at all positions.
    """

    per_speed: float
    cells: Array
    first: Rows
    part: Array
    is_even: bool

    def limits(self, time: int, v: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (S, B) N m at speeds (S, B)."""
        place = np.fmin(np.abs(v) * self.per_speed, SPEEDS - 1.000001)
        cell = place.astype(np.intp)
        between = (place - cell)[..., None]
        number = cell + self.first[time]
        at = self.cells.take(number, axis=0)
        limits = at[..., :2] + between * at[..., 2:]
        if not self.is_even:
            at = self.cells.take(number + SPEEDS, axis=0)
            behind = at[..., :2] + between * at[..., 2:]
            limits = limits + self.part[time] * (behind - limits)
        return limits[..., 0], limits[..., 1]


def _place(grid: Array, values: Array) -> tuple[Rows, Array]:
    """Return the cell of each value on an even grid, and the place in it, 0 to 1."""
    place = (values - grid[0]) / (grid[1] - grid[0])
    place = np.clip(place, 0.0, len(grid) - 1.000001)
    cell: Rows = place.astype(np.intp)
    return cell, np.asarray(place - cell)
