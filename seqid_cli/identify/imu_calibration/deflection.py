"""How far the joints before an IMU deflect: accelerations of a link that no encoder shows.

Per node the residual of the C readings is r = A a + e: e the noise of the readings, a (n,) the
accelerations by which the joints deflect, both white within the low-pass's band. With r and A over
the noise that raw readings show, r has the covariance S = K + A V A', V = diag(v), K diagonal with
one factor k for each kind of sensor (accelerometers, gyro). The sizes v and k are those of the
largest likelihood. As nodes are closer to each other than the band is wide, each counts as `share`
of a node (b), the variance of a low-passed unit noise:

    -2 log L = sum_n [ b log det S + r' S^-1 r ].

Each round multiplies v_j and k by the root of the ratio of both terms' slopes, which never lessens
L (Zhou, Hu, Zhou, Lange: MM algorithms for variance components models, 2019).

Links also jolt faster than the log's rate; that aliases, and no encoder shows it either. The
same likelihood of the raw readings' roughness, near the Nyquist rate, gives the jolts' size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.imu_calibration.normal_equations import Linearised, Seen, Sizes
from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.typing import Array

ROUNDS = 40
BEYOND = 1.5  # times the jolts' size, better than which roughness does not know the band
SIGNIFICANT = 5.0  # standard deviations of a deflection's likelihood beyond the jolts'
LEAST = 1e-3  # rad/s^2 of a node: of a smaller size nothing depends


@dataclass(frozen=True)
class Deflection:
    """Of one joint: RMS rad/s^2 below the cut-off, and its standard deviations above jolts."""

    joint: int
    acceleration: float
    significance: float

    @property
    def sure(self) -> bool:
        """Whether it is significant."""
        return self.significance > SIGNIFICANT


@dataclass(frozen=True)
class Rows:
    """Sums over all nodes, by kind of sensor (G).

    `B` (N, G, n, n), `u` (N, G, n), the share (N,) of a node that each counts; `squares` (G,) and
    `count` (N, G) of readings.
    """

    B: Array
    u: Array
    share: Array
    squares: Array
    count: Array


def residual_rows(linear: Sequence[Linearised]) -> Rows:
    """Residuals, which the low-pass makes alike from node to node."""
    return _rows([(x.deflection, band_share(x.segment)) for x in linear])


def jolt_rows(linear: Sequence[Linearised]) -> Rows:
    """Roughness of raw readings, of other samples at every node."""
    return _rows([(x.jolts, 1.0) for x in linear])


def _rows(parts: Sequence[tuple[Seen, float]]) -> Rows:
    return Rows(
        B=np.concatenate([own.B for own, _ in parts]),
        u=np.concatenate([own.u for own, _ in parts]),
        share=np.concatenate([np.full(len(own.u), b) for own, b in parts]),
        squares=np.sum([own.squares.sum(axis=0) for own, _ in parts], axis=0),
        count=np.concatenate([own.count for own, _ in parts]),
    )


def band_share(segment: Segment) -> float:
    """Variance that the low-pass leaves of white noise of unit variance per node."""
    lowpass = Lowpass(segment.cutoff_hz, segment.share / segment.spacing)
    impulse = np.zeros((4 * lowpass.settling + 1, 1))
    impulse[len(impulse) // 2] = 1.0
    return float(segment.share * np.sum(lowpass(impulse, np.ones(len(impulse), dtype=bool)) ** 2))


def renewed(linear: Sequence[Linearised], sizes: Sizes) -> Sizes:
    """Likeliest sizes, from those that the equations were scaled by.

    A trajectory that a coarse encoder hardly holds takes up jolts: they count in full, whatever is
    left of them.
    """
    jolts = likeliest(jolt_rows(linear), sizes).deflection
    return likeliest(residual_rows(linear), sizes, jolts)


def likeliest(rows: Rows, sizes: Sizes, least: Array | float = LEAST) -> Sizes:
    """Sizes of the largest likelihood among those of at least `least` rad/s^2 of a node.

    `sizes` are where the search starts.
    """
    found = Sizes(sizes.noise, np.maximum(sizes.deflection, np.maximum(least, LEAST)))
    for _ in range(ROUNDS):
        slopes = _slopes(rows, found)
        known = slopes.count > 0.0  # not a gyro's, whose raw readings hold no jolts
        ratio = np.where(known, slopes.squares / np.where(known, slopes.count, 1.0), 1.0)
        noise = found.noise * np.sqrt(ratio)
        spread = found.deflection * np.sqrt(np.sqrt(slopes.pull / np.maximum(slopes.room, 1e-300)))
        found = Sizes(np.maximum(noise, 1e-12), np.maximum(spread, np.maximum(least, LEAST)))
    return found


@dataclass(frozen=True)
class _Slopes:
    """Both terms' slopes: in the noise's factors (G,), in the deflections' variances (n,)."""

    squares: Array
    count: Array
    pull: Array
    room: Array


def _slopes(rows: Rows, sizes: Sizes) -> _Slopes:
    k, v = sizes.noise, sizes.deflection**2
    M = np.linalg.inv(np.diag(1.0 / v) + _over(rows.B, k))
    x = (M @ _over(rows.u, k)[:, :, None])[:, :, 0]  # the accelerations, given the residuals
    Bx = (rows.B @ x[:, None, :, None])[..., 0]
    own = np.einsum("ngi,ni->g", Bx - 2.0 * rows.u, x)
    fitted = np.einsum("ngij,nji->ng", rows.B, M) / k
    room = rows.share @ (1.0 / v - np.diagonal(M, axis1=1, axis2=2) / v**2)
    return _Slopes(
        squares=np.maximum(rows.squares + own, 1e-300) / k**2,
        count=rows.share @ (rows.count - fitted) / k,
        pull=np.sum((x / v) ** 2, axis=0),
        room=room,
    )


def _over(values: Array, noise: Array) -> Array:
    """Sum (N, ...) over kinds of sensors of values (N, G, ...) over their noise."""
    return np.asarray(np.tensordot(values, 1.0 / noise, axes=(1, 0)))


def deflections(linear: Sequence[Linearised], sizes: Sizes) -> tuple[Deflection, ...]:
    """Every joint's deflection, by the likelihood that it is more than jolts."""
    rows, share = residual_rows(linear), float(np.mean([band_share(x.segment) for x in linear]))
    jolts = likeliest(jolt_rows(linear), sizes).deflection
    best = log_likelihood(rows, sizes)
    found = []
    for joint, size in enumerate(sizes.deflection):
        without = sizes.deflection.copy()
        without[joint] = min(size, BEYOND * jolts[joint])
        gain = max(best - log_likelihood(rows, Sizes(sizes.noise, without)), 0.0)
        found.append(Deflection(joint, float(size * np.sqrt(share)), float(np.sqrt(2 * gain))))
    return tuple(found)


def log_likelihood(rows: Rows, sizes: Sizes) -> float:
    """Log likelihood of sizes."""
    k, v = sizes.noise, sizes.deflection**2
    B, u = _over(rows.B, k), _over(rows.u, k)
    inner = np.diag(1.0 / v) + B
    x = np.linalg.solve(inner, u[:, :, None])[:, :, 0]
    logarithm = np.linalg.slogdet(inner)[1] + np.sum(np.log(v)) + rows.count @ np.log(k)
    squares = float(np.sum(rows.squares / k)) - float(np.sum(u * x))
    return -0.5 * (float(rows.share @ logarithm) + squares)
