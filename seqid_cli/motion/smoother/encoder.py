"""What an encoder's codes say of a joint's position: the edges it crosses, and the codes."""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class EncoderView:
    """What a joint's encoder codes say: `step` rad (0 where not quantised) and white noise rad^2.

    `edge` (N,) is the position of the edge crossed between a sample and the next, else NaN;
    `dwell` (N,) how many samples the code lasted. Only every `stride`-th place was sampled, and
    of those, the `known` ones (N,) hold a position.
    """

    q: Array
    step: float
    white: float
    edge: Array
    dwell: Array
    known: Mask
    stride: int = 1

    @property
    def edges(self) -> Array:
        """Positions (N,) of the edges, zero where there are none."""
        return np.asarray(np.nan_to_num(self.edge))

    def refined(self, stride: int) -> "EncoderView":
        """The same with `stride` places per sample; edges lie between samples."""
        edge = np.full(len(self.q) * stride, np.nan)
        edge[(stride - 1) // 2 :: stride] = self.edge
        known = np.zeros(len(edge), dtype=bool)
        known[::stride] = self.known
        q, dwell = np.repeat(self.q, stride), np.repeat(self.dwell, stride)
        return replace(self, q=q, edge=edge, dwell=dwell, known=known, stride=stride)

    def weights(
        self, speed: Array, dt: float, *, edge: float = 0.03, smallest_variance: float = 1e-16
    ) -> tuple[Array, Array]:
        """Weights, 1/rad^2, of samples and of the edges half a sample after them.

        A joint that crosses an edge was there within one sample: its position is known to
        speed * dt / sqrt 12, which beats step / sqrt 12 below one count per sample. While a code
        lasts its samples say the same again and again; together they count once.
        """
        uniform = self.step**2 / 12
        if not self.step or not np.isfinite(self.edge).any():
            known = self.known / max(self.white + uniform, smallest_variance)
            return known / (self.dwell if self.step else 1.0), np.zeros(len(self.q))
        moved = np.abs(speed) * dt * self.stride
        fast = moved >= self.step
        crossing = np.isfinite(self.edge) & ~fast
        edges = crossing / (moved**2 / 12 + (edge * self.step) ** 2 + self.white)
        samples = 1.0 / (uniform * np.where(fast, 1.0, self.dwell) + self.white)
        return samples * self.known, edges


def bridged(q: Array, known: Mask) -> Array:
    """Positions (N,) with straight lines where they are not known; zero if none is."""
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros(len(q))
    return np.asarray(np.interp(np.arange(len(q)), at, q[at]))


def encoder_view(
    q: Array, step: float, valid: Mask | None = None, *, noisy: float = 0.3
) -> EncoderView:
    """Read codes and edges off one joint's positions (N,) [rad], where they are finite."""
    known: Mask = np.isfinite(q) if valid is None else np.isfinite(q) & valid
    if not known.all():
        q = bridged(q, known)
    nowhere, once = np.full(len(q), np.nan), np.ones(len(q))
    white = float(white_noise(q[:, None], known)[0]) ** 2
    if step <= 0:
        return EncoderView(q, 0.0, white, nowhere, once, known)
    code = np.round(q / step)
    change = np.diff(code)
    between = known[1:] & known[:-1]
    at = np.flatnonzero((change != 0) & between)
    back = (np.diff(at) <= 3) & (change[at[1:]] * change[at[:-1]] < 0)
    if len(at) > 20 and float(np.mean(back)) > noisy:
        return EncoderView(q, step, white, nowhere, once, known)
    edge = nowhere.copy()
    single = at[np.abs(change[at]) == 1]
    edge[single] = 0.5 * (q[single] + q[single + 1])
    bounds = np.concatenate(([0], np.flatnonzero((change != 0) | ~between) + 1, [len(q)]))
    lasting = np.diff(bounds)
    dwell = np.repeat(lasting, lasting).astype(float)
    return EncoderView(q, step, 0.0, edge, dwell, known)
