"""Joint nonlinear least squares for an IMU's constants over all segments.

Gauss-Newton with Tukey's weights. Gains, tilts and the changes of a bias from log to log have
normal priors whose widths come from the data (empirical Bayes: the mean square of the estimates
plus what the data leave open), so good sensors lend their strength to the mounting and bad ones do
not. Where a joint before the IMU deflects, the accelerations by which it does have the size of the
largest likelihood (`imu_deflection`). Standard errors are the larger of the model's own and those
of the scores' long-run variance, summed over blocks of time within which residuals may depend on
each other as they like.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.imu_calibration.deflection import Deflection, deflections, renewed
from seqid_cli.identify.imu_calibration.normal_equations import (
    Local,
    Reduced,
    Sizes,
    at_samples,
    effective,
    kinds_of,
    linearise,
    reduced,
    residual,
)
from seqid_cli.identify.imu_calibration.priors import (
    FEW,
    Widths,
    first_widths,
    gauge_information,
    next_width,
    own_precision,
    prior_of,
    values_of,
)
from seqid_cli.identify.imu_calibration.segments import REACH, Segment
from seqid_cli.identify.imu_calibration.sensor_model import Constants, channels_of
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array

ROUNDS, PLAIN_ROUNDS, FREEZE = 25, 2, 5
SETTLED = 0.1  # of a standard error, of the last step
LARGEST_TURN = 0.3
FACTOR = 10.0  # that a gain may be off nominal: beyond it the readings are of something else
LEAST_OTHERS = 0.1  # share of the information that the other logs must have
BLOCK_S, BLOCK_PERIODS = 0.25, 4.0
FIRST_SIZE = 10.0  # rad/s^2 of a node, that joints may deflect by at first


@dataclass(frozen=True)
class Fit:
    """The minimum: constants and their errors.

    `covariance` (p, p) of the constants in the order of `Constants.moved`; `prior` (p,) the prior
    standard deviations; `kept`, `outliers` count readings.
    """

    constants: Constants
    covariance: Array
    prior: Array
    kept: int
    outliers: int
    converged: bool
    holdout: float | None
    deflections: tuple[Deflection, ...] = ()


@dataclass(frozen=True)
class _State:
    """Where the fit stands: constants, what is each segment's own, widths of the priors."""

    segments: list[Segment]
    robot: Robot
    imu: Imu
    constants: Constants
    locals_: list[Local]
    widths: Widths

    @classmethod
    def first(cls, segments: list[Segment], robot: Robot, imu: Imu, start: Constants) -> _State:
        count = len(start.bias)
        locals_ = [Local(s.start, np.zeros(count), np.zeros(len(s.locked))) for s in segments]
        return cls(segments, robot, imu, start, locals_, first_widths(count))

    def noise_scale(self) -> Array:
        """Robust standard deviation (C,) of the low-passed residuals."""
        parts = []
        for segment, own in zip(self.segments, self.locals_, strict=True):
            r, good, _ = residual(segment, self.robot, self.imu, self.constants, own)
            parts.append(np.where(good, r, np.nan))
        scale = PER_MEDIAN * np.nanmedian(np.abs(np.concatenate(parts)), axis=0)
        sigma: Array = np.maximum(np.nan_to_num(scale, nan=1.0), 1e-6)
        return sigma

    def reductions(
        self, sigma: Array, sizes: Sizes | None, weights: Sequence[Array] | None
    ) -> list[Reduced]:
        """The linear equations of each segment with its trajectory taken out."""
        own_weights: Sequence[Array | None] = weights or [None] * len(self.segments)
        return [
            reduced(linearise(s, self.robot, self.imu, self.constants, own, sigma, sizes, w))
            for s, own, w in zip(self.segments, self.locals_, own_weights, strict=True)
        ]

    def moved(
        self, step: Array, share: float, reductions: list[Reduced], inner: list[_Inner]
    ) -> _State:
        """The state after a step of the constants.

        Raises
        ------
        QualityError
            If a gain is beyond `FACTOR`, or no number.
        """
        constants = self.constants.moved(step)
        if not np.abs(constants.log_gain).max() < np.log(FACTOR):  # NaN neither
            raise QualityError(
                "its readings are not those of a sensor on that link: no gain explains them",
                hint="Check gravity in the robot file, units and axes of the IMU, after_joint and "
                "the order of the joints (seqid inspect LOG... -r ROBOT).",
                where=self.imu.name,
            )
        locals_ = [
            _moved(own, r, step, i, share)
            for own, r, i in zip(self.locals_, reductions, inner, strict=True)
        ]
        return replace(self, constants=constants, locals_=locals_)


def fit_constants(segments: list[Segment], robot: Robot, imu: Imu, start: Constants) -> Fit:
    """Refine the constants from a start nearby.

    Where the residual shows that a joint deflects, all is fitted once more with the accelerations
    by which it does as noise.

    Raises
    ------
    QualityError
        If no constants of any such sensor explain the readings.
    """
    found, sizes = _fitted(_State.first(segments, robot, imu, start), None)
    if not any(deflection.sure for deflection in found.deflections):
        return found
    return _fitted(_State.first(segments, robot, imu, found.constants), sizes)[0]


def _fitted(state: _State, sizes: Sizes | None) -> tuple[Fit, Sizes]:
    """Fit with the noise of raw readings, or from sizes on that are renewed in every round."""
    change, fixed = np.inf, None
    for number in range(ROUNDS):
        sigma = state.noise_scale()
        robust = sigma if number >= PLAIN_ROUNDS else np.full(len(sigma), np.inf)
        reductions = state.reductions(robust, sizes, fixed)
        if number == FREEZE:  # weights that jump to and fro would keep the fit from settling
            fixed = [r.linear.weights for r in reductions]
        step, information, inner = _solve(reductions, state)
        covariance = _inverse(information)
        change = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        share = 1.0 if sizes is None or number < FREEZE else 0.5  # whole ones may jump to and fro
        state = state.moved(share * _limited(step), share, reductions, inner)
        state = replace(state, widths=_renewed(state, covariance, inner))
        if sizes is not None:
            sizes = renewed([r.linear for r in reductions], sizes)
        if number > FREEZE and change < SETTLED:
            break
    reductions = state.reductions(state.noise_scale(), sizes, None)
    linear = [r.linear for r in reductions]
    sizes = renewed(linear, sizes or _first_sizes(state.imu))
    fit = _finished(reductions, state, converged=change < SETTLED)
    return replace(fit, deflections=deflections(linear, sizes)), sizes


def _first_sizes(imu: Imu) -> Sizes:
    return Sizes(np.ones(kinds_of(imu).max() + 1), np.full(imu.after_joint + 1, FIRST_SIZE))


@dataclass(frozen=True)
class _Inner:
    """How a segment's own border follows the constants: own = free - follow @ step."""

    free: Array
    follow: Array
    covariance: Array


def _solve(reductions: list[Reduced], state: _State) -> tuple[Array, Array, list[_Inner]]:
    """Step (p,), information (p, p), and the segments' own borders."""
    widths = state.widths
    prior = prior_of(widths)
    p = len(prior)
    information = np.diag(prior**-2.0) + gauge_information(state.imu, len(widths.gain), p)
    gradient = -values_of(state.constants) / prior**2
    inner = []
    for r, own in zip(reductions, state.locals_, strict=True):
        weights = own_precision(r.linear.segment, widths)
        Sll = r.S[p:, p:] + np.diag(weights)
        gl = r.g[p:] - weights * np.concatenate([own.bias, own.offset])
        cover = _inverse(Sll)
        follow = cover @ r.S[p:, :p]
        information = information + r.S[:p, :p] - r.S[:p, p:] @ follow
        gradient = gradient + r.g[:p] - follow.T @ gl
        inner.append(_Inner(cover @ gl, follow, cover))
    information = 0.5 * (information + information.T)
    step = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
    return step, information, inner


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _limited(step: Array) -> Array:
    turn = float(np.linalg.norm(step[:3]))
    return step * min(1.0, LARGEST_TURN / max(turn, 1e-12))


def _moved(own: Local, reduction: Reduced, step: Array, inner: _Inner, share: float) -> Local:
    change = share * inner.free - inner.follow @ step
    border = np.concatenate([step, change])
    moved = share * reduction.free - reduction.back @ border
    c = len(own.bias)
    return Local(
        own.trajectory + moved.reshape(own.trajectory.shape),
        own.bias + change[:c],
        own.offset + change[c:],
    )


def _renewed(state: _State, covariance: Array, inner: list[_Inner]) -> Widths:
    """Widths of the priors, per kind of sensor."""
    constants, locals_, widths = state.constants, state.locals_, state.widths
    c = len(constants.bias)
    k = channels_of(state.imu)[2]
    left_open = np.diag(covariance)
    drift = np.array([own.bias for own in locals_])
    drift_open = np.array([np.diag(i.covariance)[:c] for i in inner])
    result = replace(widths)
    for group in (slice(0, k), slice(k, c)):
        size = group.stop - group.start
        if size >= FEW:
            own = left_open[7 + c : 7 + 2 * c][group]
            result.gain[group] = next_width(constants.log_gain[group], own, widths.gain[group])
            own = left_open[7 + 2 * c :].reshape(c, 2)[group]
            wide = widths.tilt[group][:, None]
            result.tilt[group] = next_width(constants.tilt[group], own, wide)
        if size and len(locals_) > 1:
            result.drift[group] = next_width(
                drift[:, group], drift_open[:, group], widths.drift[group]
            )
    return result


def _finished(reductions: list[Reduced], state: _State, *, converged: bool) -> Fit:
    _, information, inner = _solve(reductions, state)
    model = _inverse(information)
    blocks, own_share = [], np.zeros_like(model)
    for r, own, i in zip(reductions, state.locals_, inner, strict=True):
        scores, share = _scores(r, own, i, state.widths)
        blocks.append(scores)
        own_share += share
    return Fit(
        constants=state.constants,
        covariance=_widened(model, np.concatenate(blocks), own_share, state.widths, state.imu),
        prior=prior_of(state.widths),
        kept=sum(int(r.linear.used.sum()) for r in reductions),
        outliers=sum(int(r.linear.outliers.sum()) for r in reductions),
        converged=converged,
        holdout=_left_out(reductions, inner, information),
    )


def _scores(reduction: Reduced, own: Local, inner: _Inner, widths: Widths) -> tuple[Array, Array]:
    """Scores (blocks, p) of a segment, and the information (p, p) of its own priors."""
    linear, segment = reduction.linear, reduction.linear.segment
    readings, encoders, jerk = effective(reduction)
    p = inner.follow.shape[1]

    def onto(columns: Array) -> Array:
        result: Array = columns[..., :p] - columns[..., p:] @ inner.follow
        return result

    length = max(BLOCK_S, BLOCK_PERIODS / segment.cutoff_hz)
    block = (np.arange(segment.samples) * segment.spacing / length).astype(int)
    out = np.zeros((block[-1] + 1, p))
    np.add.at(out, block, np.einsum("nc,ncp->np", linear.r, onto(readings)))
    for rows, columns, off in zip(
        segment.encoders, encoders, linear.encoder_residuals, strict=True
    ):
        at = np.clip(rows.at + 1 - 4, 0, segment.samples - 1)
        np.add.at(out, block[at], (rows.information * off)[:, None] * onto(columns))
    at = np.clip(np.arange(len(jerk)) - 2, 0, segment.samples - 1)
    pull = linear.jerk_residual / segment.jerk**2
    np.add.at(out, block[at], np.einsum("nm,nmp->np", pull, onto(jerk)))
    precision = own_precision(segment, widths)
    share = inner.follow.T @ (precision[:, None] * inner.follow)
    return out, share


def _widened(model: Array, scores: Array, own: Array, widths: Widths, imu: Imu) -> Array:
    """The model's covariance, each standard error at least that of the scores' own variance."""
    p = len(model)
    count = len(scores)
    share = count / max(count - 5.0, 0.5 * count)
    gauge = gauge_information(imu, len(widths.gain), p)
    omega = share * scores.T @ scores + own + np.diag(prior_of(widths) ** -2.0) + gauge
    seen = model @ omega @ model
    factor = np.sqrt(np.maximum(np.diag(seen) / np.diag(model), 1.0))
    covariance: Array = model * np.outer(factor, factor)
    return covariance


def _left_out(reductions: list[Reduced], inner: list[_Inner], information: Array) -> float | None:
    """RMS of what each log reads beyond the prediction by all the others, over the fit's own.

    Both are whitened residuals after each log's own trajectory; one means that the constants carry
    over to a log that they have not seen. What only one log shows cannot be predicted by the others
    and does not count.
    """
    logs = sorted({r.linear.segment.log for r in reductions})
    if len(logs) < 2:
        return None
    p = len(information)
    total, before = 0.0, 0.0
    for log in logs:
        members = [k for k, r in enumerate(reductions) if r.linear.segment.log == log]
        S, g = np.zeros((p, p)), np.zeros(p)
        for k in members:
            r, i = reductions[k], inner[k]
            S += r.S[:p, :p] - r.S[:p, p:] @ i.follow
            g += r.g[:p] - i.follow.T @ r.g[p:]
        step = -without(information, S, g)
        for k in members:
            linear, i = reductions[k].linear, inner[k]
            columns = effective(reductions[k])[0]
            columns = columns[..., :p] - columns[..., p:] @ i.follow
            moved = (linear.J.reshape(*linear.r.shape, -1) @ _followed(reductions[k]))[..., 0]
            settled = linear.r - moved
            total += float(np.sum((settled - columns @ step) ** 2))
            before += float(np.sum(settled**2))
    return float(np.sqrt(total / max(before, 1e-12)))


def without(information: Array, own: Array, gradient: Array) -> Array:
    """Step (p,) from one log's gradient by the others' information, where there is enough."""
    factor = np.linalg.cholesky(information)
    inner = np.linalg.solve(factor, np.linalg.solve(factor, own).T)
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    others = 1.0 - share
    along = directions.T @ np.linalg.solve(factor, gradient)
    along = np.where(others > LEAST_OTHERS, along / np.maximum(others, LEAST_OTHERS), 0.0)
    return np.asarray(np.linalg.solve(factor.T, directions @ along), dtype=np.float64)


def _followed(reduction: Reduced) -> Array:
    """What the trajectory still moves at rest constants: (N, 3 m, 1), zero at the minimum."""
    segment = reduction.linear.segment
    free = reduction.free.reshape(segment.samples + 2 * REACH, len(segment.moving))
    return at_samples(segment, free).reshape(segment.samples, -1, 1)
