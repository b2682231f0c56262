"""Where the IMU calibration begins: clock offset and mounting without a guess.

Each reading is a linear function of the link's specific force f and of H (see `imu_model`), with
twelve coefficients and a bias, whatever the mounting. Their least-squares misfit over shifts of
the clock finds the offset. The same sums, 13 by 13, hold all that a mounting can be judged by, so
that many starts cost little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.identify.imu_calibration.sensor_model import (
    Constants,
    channels_of,
    first_constants,
    link_state,
)
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

LARGEST_DELAY_S = 0.5
TERMS = 16  # f, H, w, one
LEAST_LEVER = 1.0  # m, prior
COARSE_S = 0.016
ROUGH, FINE = 60, 400  # evaluations from one start
BETTER = 0.7  # share of the misfit without a shift, above which no shift is believed


@dataclass(frozen=True)
class Sums:
    """Products of regressors (16, 16), with the readings (16, C), and of the readings (C,)."""

    xx: Array
    xy: Array
    yy: Array

    def __add__(self, other: Sums) -> Sums:
        return Sums(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy)


def starting_constants(segments: list[Segment], robot: Robot, imu: Imu, guess: Array) -> Constants:
    """Mounting, lever, offset and biases to begin with; `guess` (3, 3) is one of the starts."""
    tables = [_table(segment, robot, imu) for segment in segments]
    delay = _delay(segments, tables)
    sums = _sums(segments, tables, delay)
    rough = [_mounting(imu, sums, R, ROUGH) for R in (guess, *_turns())]
    best = min(rough, key=lambda pair: pair[0])[1]
    polished = _mounting(imu, sums, best.R, FINE)[1]
    return replace(polished, delay=delay)


def _delay(segments: list[Segment], tables: list[Array]) -> float:
    """Clock offset [s] with the least misfit: coarsely over all, then finely about the best."""
    fine = max(segment.spacing for segment in segments)
    longest = min(segment.samples * segment.spacing for segment in segments)
    coarse = fine * max(1, round(COARSE_S / fine))
    count = int(min(LARGEST_DELAY_S, longest / 4) / coarse)
    delays = np.arange(-count, count + 1) * coarse
    misfits = np.array([_misfit(segments, tables, delay) for delay in delays])
    best = int(np.argmin(misfits))
    if misfits[best] > BETTER * misfits[count]:
        best = count
    delays = delays[best] + np.arange(-coarse, coarse + 0.5 * fine, fine)
    misfits = np.array([_misfit(segments, tables, delay) for delay in delays])
    return _refined(delays, misfits, int(np.argmin(misfits)))


def _table(segment: Segment, robot: Robot, imu: Imu) -> Array:
    """Regressors (N, 16) from the encoders alone, smooth enough to differentiate."""
    rate = 1.0 / segment.spacing
    q = segment.q.copy()
    hz = _smooth_enough(segment)
    lowpass = Lowpass(hz, rate)
    q = lowpass(q)
    dq, ddq = differentiate(q, rate)
    still = [j for j in range(robot.n) if j not in segment.moving]
    dq[:, still], ddq[:, still] = 0.0, 0.0
    x = link_state(robot, imu.after_joint, q, dq, ddq)
    return np.hstack([x, np.ones((len(x), 1))])


def _smooth_enough(segment: Segment) -> float:
    return float(min(segment.cutoff_hz, max(3.0, segment.encoder_hz)))


def _shifted(segment: Segment, delay: float) -> tuple[Array, Array]:
    """Readings (N, C) a delay later, to the nearest sample, and weights (N,)."""
    readings = segment.readings
    at = np.round((segment.t + delay - readings.t[0]) / (readings.t[1] - readings.t[0]))
    inside = (at >= 0) & (at < len(readings.t))
    index = np.clip(at, 0, len(readings.t) - 1).astype(np.intp)
    return readings.values[index], inside * readings.good[index].all(axis=1).astype(float)


def _sums(segments: list[Segment], tables: list[Array], delay: float) -> Sums:
    total: Sums | None = None
    for segment, x in zip(segments, tables, strict=True):
        y, w = _shifted(segment, delay)
        wx = x * w[:, None]
        own = Sums(wx.T @ x, wx.T @ y, w @ y**2)
        total = own if total is None else total + own
    assert total is not None
    return total


def _misfit(segments: list[Segment], tables: list[Array], delay: float) -> float:
    """Share of the readings' power that the best linear function leaves over."""
    sums = _sums(segments, tables, delay)
    scale = np.sqrt(np.maximum(np.diag(sums.xx), 1e-12))
    A = sums.xx / np.outer(scale, scale)
    b = sums.xy / scale[:, None]
    solved = np.linalg.lstsq(A, b, rcond=1e-8)[0]
    left = sums.yy - np.sum(b * solved, axis=0)
    power = np.maximum(sums.yy - sums.xy[-1] ** 2 / max(sums.xx[-1, -1], 1.0), 1e-12)
    return float(np.mean(np.maximum(left, 0.0) / power))


def _refined(delays: Array, misfits: Array, best: int) -> float:
    """Minimum of the parabola through the best lag and its neighbours."""
    if not 0 < best < len(delays) - 1:
        return float(delays[best])
    a, b, c = misfits[best - 1 : best + 2]
    bend = a - 2 * b + c
    shift = 0.5 * (a - c) / bend if bend > 0 else 0.0
    return float(delays[best] + np.clip(shift, -1, 1) * (delays[1] - delays[0]))


def _turns() -> list[Array]:
    """The 24 ways in which a box may be screwed on."""
    found = []
    for a, b in product(range(6), range(4)):
        first = (
            Rotation.from_euler("y", 90 * a, degrees=True)
            if a < 4
            else Rotation.from_euler("z", 90 if a == 4 else -90, degrees=True)
        )
        found.append((first * Rotation.from_euler("x", 90 * b, degrees=True)).as_matrix())
    return found


def _mounting(imu: Imu, sums: Sums, R: Array, evaluations: int) -> tuple[float, Constants]:
    """Least squares for turn and lever on the sums, from one start; biases follow."""
    axes, places, k = channels_of(imu)
    samples = max(float(sums.xx[-1, -1]), 1.0)
    x_mean, y_mean = sums.xx[-1, :-1] / samples, sums.xy[-1] / samples
    xx = sums.xx[:-1, :-1] / samples - np.outer(x_mean, x_mean)
    xy = sums.xy[:-1] / samples - np.outer(x_mean, y_mean)
    value, vector = np.linalg.eigh(xx)
    kept = value > 1e-10 * value[-1]
    root = (vector[:, kept] * np.sqrt(value[kept])).T  # xx = root' root
    target = (vector[:, kept] / np.sqrt(value[kept])).T @ xy
    size = np.sqrt(np.maximum(sums.yy / samples - y_mean**2, 1e-6))

    def matrix(step: Array) -> Array:
        turned = Rotation.from_rotvec(step[:3]).as_matrix() @ R
        A = np.zeros((len(axes), TERMS - 1))
        u, place = axes @ turned.T, step[3:] + places[:k] @ turned.T
        A[:k, :3], A[k:, 12:] = u[:k], u[k:]
        A[:k, 3:12] = (u[:k, :, None] * place[:, None, :]).reshape(k, 9)
        return A

    def off(step: Array) -> Array:
        misfit = (root @ matrix(step).T - target) / size
        return np.concatenate([misfit.ravel(), 1e-3 * step[3:] / LEAST_LEVER])

    result = least_squares(off, np.zeros(6), method="lm", max_nfev=evaluations)
    found = Rotation.from_rotvec(result.x[:3]).as_matrix() @ R
    bias = y_mean - matrix(result.x) @ x_mean
    nominal = first_constants(imu)
    return float(result.cost), replace(nominal, R=found, lever=result.x[3:], bias=bias)
