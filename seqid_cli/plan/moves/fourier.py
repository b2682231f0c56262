"""Fourier moves that start and stop smoothly, and whose limits hold by construction.

A joint follows q(t) = c + A y(t) with the shapes y(t) of `motion.planned`. The
amplitude A is the largest that range, speed and acceleration allow; the centre c is
placed by a share in [0, 1] of the room that is left. So every set of coefficients is a
move within the limits.

M moves are drawn as an array (M, n, 2 K + 2): for each joint the coefficients a_1, b_1,
a_2, ..., then at `PLACE` its share of the free room and at `EXTENT` that of the largest
amplitude. A joint whose coefficients are zero stands still at its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.plan.limits import Limits
from seqid_cli.typing import Array, Index

PLACE, EXTENT = COEFFICIENTS, COEFFICIENTS + 1
# five samples and more to a period of the highest harmonic of a 2 s move
COARSE_HZ = 25.0
SPARSE = 4  # of the coarse samples, one in so many carries the information


@dataclass(frozen=True)
class Moves:
    """Moves (M, N, n) over common times t (N,) s: positions, speeds and accelerations."""

    t: Array
    q: Array
    dq: Array
    ddq: Array

    def every(self, step: int) -> Moves:
        """One sample in `step`."""
        some = slice(None, None, step)
        return Moves(self.t[some], self.q[:, some], self.dq[:, some], self.ddq[:, some])

    def singly(self) -> Iterator[Moves]:
        """One move at a time."""
        return (self[k : k + 1] for k in range(len(self.q)))

    def __getitem__(self, which: slice | Index) -> Moves:
        """Some of the moves."""
        return Moves(self.t, self.q[which], self.dq[which], self.ddq[which])


def placed(shapes: Shapes, drawn: Array, limits: Limits) -> Moves:
    """Scale and place shapes (M, n, 2 K + 2) so that they use the limits and keep them."""
    y, dy, ddy = (
        drawn[..., :COEFFICIENTS] @ part for part in (shapes.y, shapes.dy, shapes.ddy)
    )
    low, span, room = y.min(axis=2), np.ptp(y, axis=2), limits.range
    used = [span, np.abs(dy).max(axis=2), np.abs(ddy).max(axis=2)]
    allowed = [room, limits.speed, limits.acceleration]
    factors = [a / np.maximum(b, 1e-12) for a, b in zip(allowed, used, strict=True)]
    still = span <= 0
    amplitude = np.where(still, 0.0, drawn[..., EXTENT] * np.min(factors, axis=0))
    free = limits.lower + drawn[..., PLACE] * (room - amplitude * span)
    scaled = [
        (amplitude[:, :, None] * part).transpose(0, 2, 1) for part in (y, dy, ddy)
    ]
    centre = free - amplitude * np.where(still, 0.0, low)
    return Moves(shapes.t, centre[:, None] + scaled[0], scaled[1], scaled[2])
