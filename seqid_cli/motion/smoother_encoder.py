"""What an encoder's codes say of a joint's position: the edges it crosses, and the codes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EDGE = 0.03  # of a count, by which the places of an encoder's edges are off
NOISY = 0.3  # share of code changes that turn back at once, beyond which noise hides the edges
SMALLEST_VARIANCE = 1e-16  # rad^2, of an encoder


@dataclass(frozen=True)
class EncoderView:
    """What a joint's encoder codes say: `step` rad (0 where not quantised) and white noise rad^2.

    `edge` (N,) is the position of the edge crossed between a sample and the next, else NaN;
    `dwell` (N,) how many samples the code lasted. Only every `stride`-th place from `start` on was
    sampled.
    """

    q: Array
    step: float
    white: float
    edge: Array
    dwell: Array
    stride: int = 1
    start: int = 0

    def part(self, start: int, stop: int) -> EncoderView:
        """What lies between two places."""
        own = slice(start, stop)
        first = (self.start - start) % self.stride
        return replace(self, q=self.q[own], edge=self.edge[own], dwell=self.dwell[own], start=first)

    def refined(self, stride: int) -> EncoderView:
        """The same with `stride` places per sample; edges lie between samples."""
        edge = np.full(len(self.q) * stride, np.nan)
        edge[(stride - 1) // 2 :: stride] = self.edge
        q, dwell = np.repeat(self.q, stride), np.repeat(self.dwell, stride)
        return replace(self, q=q, edge=edge, dwell=dwell, stride=stride)

    def weights(self, speed: Array, dt: float) -> tuple[Array, Array]:
        """Weights, 1/rad^2, of samples and of the edges half a sample after them.

        A joint that crosses an edge was there within one sample: its position is known to
        speed * dt / sqrt 12, which beats step / sqrt 12 below one count per sample. While a code
        lasts its samples say the same again and again; together they count once.
        """
        uniform = self.step**2 / 12
        sampled = np.zeros(len(self.q))
        sampled[self.start :: self.stride] = 1.0
        if not self.step or not np.isfinite(self.edge).any():
            known = np.full(len(self.q), 1.0 / max(self.white + uniform, SMALLEST_VARIANCE))
            known *= sampled / (self.dwell if self.step else 1.0)
            return known, np.zeros(len(self.q))
        moved = np.abs(speed) * dt * self.stride
        fast = moved >= self.step
        crossing = np.isfinite(self.edge) & ~fast
        edges = crossing / (moved**2 / 12 + (EDGE * self.step) ** 2 + self.white)
        samples = 1.0 / (uniform * np.where(fast, 1.0, self.dwell) + self.white)
        return samples * sampled, edges


def encoder_view(q: Array, step: float) -> EncoderView:
    """Read codes and edges off one joint's positions (N,) [rad]."""
    nowhere = np.full(len(q), np.nan)
    white = float(np.median(np.abs(np.diff(q, 4))) / 0.6745) ** 2 / 70.0 if len(q) > 8 else 0.0
    if step <= 0:
        return EncoderView(q, 0.0, white, nowhere, np.ones(len(q)))
    code = np.round(q / step)
    change = np.diff(code)
    at = np.flatnonzero(change)
    back = (np.diff(at) <= 3) & (change[at[1:]] * change[at[:-1]] < 0)
    if len(at) > 20 and float(np.mean(back)) > NOISY:
        return EncoderView(q, step, white, nowhere, np.ones(len(q)))
    edge = nowhere.copy()
    single = at[np.abs(change[at]) == 1]
    edge[single] = 0.5 * (q[single] + q[single + 1])
    bounds = np.concatenate(([0], at + 1, [len(q)]))
    lasting = np.diff(bounds)
    dwell = np.repeat(lasting, lasting).astype(float)
    return EncoderView(q, step, 0.0, edge, dwell)
