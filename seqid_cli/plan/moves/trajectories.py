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
    own = {}
    if move.strokes:  # of one joint, each with a rest after it
        rest = round(REST_S * rate_hz)
        parts = [np.outer([move.strokes[0].start, 0.0, 0.0], np.ones(rest + 1))]
        for stroke in move.strokes:
            still = np.outer([stroke.end, 0.0, 0.0], np.ones(rest))
            parts += [np.array(profile(stroke, rate_hz)), still]
        own[move.joints[0]] = np.concatenate(parts, axis=1)
        t = np.arange(own[move.joints[0]].shape[1]) / rate_hz
    else:
        shapes = Shapes.over(move.duration_s, rate_hz)
        t, c = shapes.t, np.empty(COEFFICIENTS)
        for name, motion in move.fourier.items():
            c[0::2], c[1::2] = motion.sine, motion.cosine
            own[name] = np.array([motion.centre + c @ shapes.y, c @ shapes.dy, c @ shapes.ddy])
    states = np.zeros((3, len(t), len(names)))
    states[0] = [move.start[name] for name in names]
    for name, values in own.items():
        states[:, :, list(names).index(name)] = values
    return t, *states
