"""Friction of thinned motion: where a joint reverses, what is left of its step below the samples.

Friction steps where a joint reverses, so its spectrum goes far beyond half of a thinned rate, and
samples of it say only to half a sample when it stepped. Around reversals the velocity is therefore
interpolated, friction computed at `PARTS` points per sample, and these go through a short low-pass
that passes what the motion's own one does (it is flat up to twice the cut-off at ten samples per
period) and stops what would be folded back there. Elsewhere friction is as smooth as the motion;
where samples are many per period of the cut-off, what would be folded back is little and far above.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.signal import firwin

from seqid_cli.model.friction import FrictionSurface, friction_torque
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.types import Array

Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

PARTS = 8
HALF = 4  # samples on either side that the low-pass reaches
KNOTS = np.arange(-2, 4)  # samples about a point that it is interpolated from


def sampled_friction(
    surfaces: list[FrictionSurface | None], motion: Motion, *, dense: float = 80.0
) -> Array:
    """Friction torque of a motion, its step at reversals kept below half of the rate.

    Returns (N, n) [N m; N where prismatic]: before the motion's own low-pass; zero for a joint
    whose friction is not known.
    """
    torque = friction_torque(surfaces, motion.q, motion.dq)
    if motion.rate_hz >= dense * motion.lowpass.cutoff_hz:
        return torque
    inside = shrink(motion.valid, HALF + len(KNOTS) // 2)
    for j, surface in enumerate(surfaces):
        if surface is not None:
            near = np.flatnonzero(inside & _near_reversals(motion, j, surface.sign_width))
            if near.size:
                torque[near, j] = _band_limited(surface, motion.q[:, j], motion.dq[:, j], near)
    return torque


def _near_reversals(motion: Motion, j: int, width: float, *, wide: float = 3.0) -> Mask:
    """Samples (N,) that the low-pass reaches from where a joint is slower than the sign's width."""
    v, moving = motion.dq[:, j], motion.moving[:, j]
    slow = np.abs(v) < wide * width
    turns = (v[1:] * v[:-1] <= 0) | slow[1:] | slow[:-1]
    turns &= moving[1:] & moving[:-1]
    found: Mask = np.zeros(len(v), dtype=np.bool_)
    found[:-1] = turns
    found[1:] |= turns
    return np.asarray(binary_dilation(found, np.ones(2 * HALF + 1, dtype=np.bool_)))


def _band_limited(surface: FrictionSurface, q: Array, dq: Array, near: Places) -> Array:
    """Low-passed friction at samples `near` (M,) of a motion (N,)."""
    used = np.unique(near[:, None] + np.arange(-HALF, HALF + 1))
    around = used[:, None] + KNOTS
    q, dq = (x[around] @ _interpolation() for x in (q, dq))
    parts = surface.torque(q.ravel(), dq.ravel()).reshape(len(used), PARTS)
    first = np.searchsorted(used, near)[:, None] + np.arange(-HALF, HALF + 1)
    return np.asarray(np.tensordot(parts[first], _taps(), axes=2))


@lru_cache(maxsize=1)
def _interpolation() -> Array:
    """Lagrange's weights (6, PARTS) of the knots for the points from a sample to the next."""
    at = np.arange(PARTS) / PARTS
    weights = np.ones((len(KNOTS), PARTS))
    for i, knot in enumerate(KNOTS):
        for other in np.delete(KNOTS, i):
            weights[i] *= (at - other) / (knot - other)
    return weights


@lru_cache(maxsize=1)
def _taps(*, beta: float = 7.5) -> Array:
    """Low-pass (2 HALF + 1, PARTS) over the points of the samples around one."""
    taps = np.zeros((2 * HALF + 1) * PARTS)
    taps[: 2 * HALF * PARTS + 1] = firwin(2 * HALF * PARTS + 1, 1 / PARTS, window=("kaiser", beta))
    return taps.reshape(2 * HALF + 1, PARTS)
