"""Deflections of the joints before an IMU: link accelerations that no encoder shows.

Per node the residual of the C readings is r = A a + e: e the noise of the readings, a
(n,) the accelerations by which the joints deflect, both white within the low-pass's
band. With r and A over the noise that raw readings show, r has the covariance S = K + A
V A', V = diag(v), K diagonal with one factor k for each kind of sensor (accelerometers,
gyro). The sizes v and k are those of the largest likelihood. As nodes are closer to
each other than the band is wide, each counts as `share` of a node (b), the variance of
a low-passed unit noise:

    -2 log L = sum_n [ b log det S + r' S^-1 r ].

Each round multiplies v_j and k by the root of the ratio of both terms' slopes, which
never lessens L (Zhou, Hu, Zhou, Lange: MM algorithms for variance components models,
2019).

Links also jolt faster than the log's rate; that aliases, and no encoder shows it
either. The same likelihood of the raw readings' roughness, near the Nyquist rate, gives
the jolts' size.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.imu.calibration.normal_equations import Linearised, Rows, Sizes
from seqid_cli.params.schema import JointDeflection
from seqid_cli.typing import Array

SIGNIFICANT = 5.0  # standard deviations of a deflection's likelihood beyond the jolts'


def _joined(parts: Sequence[Rows]) -> Rows:
    """Return the rows of all segments."""
    return Rows(
        B=np.concatenate([part.B for part in parts]),
        u=np.concatenate([part.u for part in parts]),
        squares=np.concatenate([part.squares for part in parts]),
        count=np.concatenate([part.count for part in parts]),
        share=np.concatenate([part.share for part in parts]),
    )


def renewed(linear: Sequence[Linearised], sizes: Sizes) -> Sizes:
    """Return the likeliest sizes, from those by which the equations were scaled."""
    # A trajectory that a coarse encoder hardly holds takes up jolts. A deflection is
    # therefore at least as large as the jolts of the raw readings.
    jolts = likeliest(_joined([x.jolts for x in linear]), sizes).deflection
    return likeliest(_joined([x.deflection for x in linear]), sizes, jolts)


def likeliest(
    rows: Rows,
    start: Sizes,
    least: Array | float = 0.0,
    *,
    min_size: float = 1e-3,
    rounds: int = 40,
    done: float = 1e-12,
) -> Sizes:
    """Return the sizes of the largest likelihood.

    Parameters
    ----------
    rows : Rows
        Sums of the residuals.
    start : Sizes
        First sizes.
    least, min_size : array or float
        Smallest deflections [rad/s^2 of a node]; nothing depends on smaller ones.
    rounds : int
        Largest number of rounds.
    done : float
        Relative change of all sizes at which the rounds end.
    """
    least = np.maximum(least, min_size)
    noise = start.noise
    deflection = np.maximum(start.deflection, least)
    for _ in range(rounds):
        last_sizes = np.append(noise, deflection)
        k = noise
        v = deflection**2
        M = np.linalg.inv(np.diag(1.0 / v) + _over(rows.B, k))
        # the accelerations, given the residuals
        x = (M @ _over(rows.u, k)[:, :, None])[:, :, 0]
        Bx = (rows.B @ x[:, None, :, None])[..., 0]
        left = rows.squares.sum(axis=0) + np.einsum("ngi,ni->g", Bx - 2.0 * rows.u, x)
        count = rows.share @ (rows.count - np.einsum("ngij,nji->ng", rows.B, M) / k) / k
        known = count > 0.0  # not a gyro's, whose raw readings hold no jolts
        ratio = np.maximum(left, 1e-300) / k**2 / np.where(known, count, 1.0)
        noise = np.maximum(noise * np.sqrt(np.where(known, ratio, 1.0)), 1e-12)
        pull = np.sum((x / v) ** 2, axis=0)
        room = rows.share @ (1.0 / v - np.diagonal(M, axis1=1, axis2=2) / v**2)
        spread = deflection * np.sqrt(np.sqrt(pull / np.maximum(room, 1e-300)))
        deflection = np.maximum(spread, least)
        sizes = np.append(noise, deflection)
        if np.all(np.abs(sizes - last_sizes) <= done * last_sizes):
            break
    return Sizes(noise, deflection)


def _over(values: Array, noise: Array) -> Array:
    """Return sums (N, ...) over kinds of sensors of values (N, G, ...) / noise (G,)."""
    return np.asarray(np.tensordot(values, 1.0 / noise, axes=(1, 0)))


def deflections(
    linear: Sequence[Linearised],
    sizes: Sizes,
    names: Sequence[str],
    *,
    beyond: float = 1.5,
) -> list[JointDeflection]:
    """Return the deflection of every joint, with its significance.

    The significance compares the likelihood with that of a deflection of at most
    `beyond` times the jolts.

    Parameters
    ----------
    linear : sequence of Linearised
        Equations of all segments.
    sizes : Sizes
        Likeliest sizes of noise and deflections.
    names : sequence of str
        Names of the joints.
    beyond : float
        Ratio to the jolts up to which an acceleration is no deflection.
    """
    rows = _joined([x.deflection for x in linear])
    share = [x.deflection.share[0] for x in linear]
    jolts = likeliest(_joined([x.jolts for x in linear]), sizes).deflection
    best = _log_likelihood(rows, sizes)
    joint_deflections = []
    for joint, size in enumerate(sizes.deflection):
        without = sizes.deflection.copy()
        without[joint] = min(size, beyond * jolts[joint])
        gain = max(best - _log_likelihood(rows, Sizes(sizes.noise, without)), 0.0)
        deflection = JointDeflection(
            joint=names[joint],
            acceleration=float(size * np.sqrt(float(np.mean(share)))),
            significance=float(np.sqrt(2 * gain)),
        )
        joint_deflections.append(deflection)
    return joint_deflections


def _log_likelihood(rows: Rows, sizes: Sizes) -> float:
    """Return the log likelihood of sizes, but for a constant."""
    k = sizes.noise
    v = sizes.deflection**2
    B = _over(rows.B, k)
    u = _over(rows.u, k)
    inner = np.diag(1.0 / v) + B
    x = np.linalg.solve(inner, u[:, :, None])[:, :, 0]
    logarithm = np.linalg.slogdet(inner)[1] + np.sum(np.log(v)) + rows.count @ np.log(k)
    squares = float(np.sum(rows.squares.sum(axis=0) / k)) - float(np.sum(u * x))
    return -0.5 * (float(rows.share @ logarithm) + squares)
