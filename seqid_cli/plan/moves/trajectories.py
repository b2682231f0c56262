"""Planned moves as time series."""

from collections.abc import Sequence

import numpy as np

from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.plan.moves.fourier import COEFFICIENTS, Shapes
from seqid_cli.plan.moves.strokes import REST_S, profile
from seqid_cli.robot.types import Array

RATE_HZ = 100.0  # of the rows; controllers interpolate between them


def sampled(move: PlannedMove, names: Sequence[str], rate_hz: float) -> tuple[Array, ...]:
    """Return times (N,) s, positions, speeds and accelerations (N, n) of a planned move."""
    if move.strokes:
        return _swept(move, names, rate_hz)
    shapes = Shapes.over(move.duration_s, rate_hz)
    start = np.array([move.start[name] for name in names])
    q = np.tile(start, (len(shapes.t), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for name, motion in move.fourier.items():
        j = list(names).index(name)
        c = np.empty(COEFFICIENTS)
        c[0::2], c[1::2] = motion.sine, motion.cosine
        q[:, j] = motion.centre + c @ shapes.y
        dq[:, j], ddq[:, j] = c @ shapes.dy, c @ shapes.ddy
    return shapes.t, q, dq, ddq


def _swept(move: PlannedMove, names: Sequence[str], rate_hz: float) -> tuple[Array, ...]:
    """Strokes of one joint, each with a rest after it."""
    j = list(names).index(move.joints[0])
    rest = round(REST_S * rate_hz)
    parts = [np.array([np.full(rest + 1, move.strokes[0].start), *np.zeros((2, rest + 1))])]
    for stroke in move.strokes:
        parts.append(np.array(profile(stroke, rate_hz)))
        parts.append(np.array([np.full(rest, stroke.end), *np.zeros((2, rest))]))
    joined = np.concatenate(parts, axis=1)
    q = np.tile([move.start[name] for name in names], (joined.shape[1], 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    q[:, j], dq[:, j], ddq[:, j] = joined
    return np.arange(len(q)) / rate_hz, q, dq, ddq
