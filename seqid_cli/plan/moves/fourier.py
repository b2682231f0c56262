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
    """Samples of M moves of n joints over common times.

    Parameters
    ----------
    t : (N,) float
        Times [s].
    q, dq, ddq : (M, N, n) float
        Positions, speeds and accelerations [rad, rad/s, rad/s^2; m where prismatic].
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array

    def every(self, step: int) -> Moves:
        """Return one sample in `step`."""
        samples = slice(None, None, step)
        return Moves(
            self.t[samples],
            self.q[:, samples],
            self.dq[:, samples],
            self.ddq[:, samples],
        )

    def singly(self) -> Iterator[Moves]:
        """Return the moves one at a time."""
        return (self[k : k + 1] for k in range(len(self.q)))

    def __getitem__(self, moves: slice | Index) -> Moves:
        """Return some of the moves."""
        return Moves(self.t, self.q[moves], self.dq[moves], self.ddq[moves])


def placed(shapes: Shapes, drawn: Array, limits: Limits) -> Moves:
    """Scale and place shapes so that they use the limits and keep them.

    Parameters
    ----------
    shapes : Shapes
        The 2 K shapes of unit coefficients.
    drawn : (M, n, 2 K + 2) float
        Coefficients, place and extent of each joint.
    limits : Limits

    Returns
    -------
    Moves
        At the times of the shapes.
    """
    coefficients = drawn[..., :COEFFICIENTS]
    y = coefficients @ shapes.y
    dy = coefficients @ shapes.dy
    ddy = coefficients @ shapes.ddy

    # The limit that is reached first decides the amplitude.
    span = np.ptp(y, axis=2)
    largest_amplitude = np.min(
        [
            limits.range / np.maximum(span, 1e-12),
            limits.speed / np.maximum(np.abs(dy).max(axis=2), 1e-12),
            limits.acceleration / np.maximum(np.abs(ddy).max(axis=2), 1e-12),
        ],
        axis=0,
    )
    still = span <= 0
    amplitude = np.where(still, 0.0, drawn[..., EXTENT] * largest_amplitude)

    # The lowest position comes to its share of the room that the amplitude leaves.
    lowest = limits.lower + drawn[..., PLACE] * (limits.range - amplitude * span)
    centre = lowest - amplitude * np.where(still, 0.0, y.min(axis=2))
    return Moves(
        shapes.t,
        centre[:, None] + _scaled(y, amplitude),
        _scaled(dy, amplitude),
        _scaled(ddy, amplitude),
    )


def _scaled(y: Array, amplitude: Array) -> Array:
    """Return the shapes y (M, n, N) times amplitudes (M, n), samples before joints."""
    return np.asarray((amplitude[:, :, None] * y).transpose(0, 2, 1))
