"""Joint nonlinear least squares for an IMU's constants over all segments.

Gauss-Newton with Tukey's weights. Gains, tilts and the changes of a bias from log to log have
normal priors whose widths come from the data (empirical Bayes: the mean square of the estimates
plus what the data leave open), so good sensors lend their strength to the mounting and bad ones do
not. Where a joint before the IMU deflects, the accelerations by which it does have the size of the
largest likelihood (`deflection`). Standard errors are the larger of the model's own and those
of the scores' long-run variance, summed over blocks of time within which residuals may depend on
each other as they like.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.imu_calibration.deflection import (
    SIGNIFICANT,
    Deflection,
    deflections,
    renewed,
)
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
from seqid_cli.identify.imu_calibration.segments import REACH, Segment
from seqid_cli.identify.imu_calibration.sensor_model import (
    FEW,
    Constants,
    Widths,
    channels_of,
    first_widths,
    gauge_information,
    next_width,
    own_precision,
    prior_of,
    values_of,
)
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array


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
    def first(cls, segments: list[Segment], robot: Robot, imu: Imu, start: Constants) -> "_State":
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
        return np.asarray(np.maximum(np.nan_to_num(scale, nan=1.0), 1e-6))

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
        self,
        step: Array,
        share: float,
        reductions: list[Reduced],
        inner: "list[_Inner]",
        *,
        max_factor: float = 10.0,
    ) -> "_State":
        """The state after a step of the constants.

        Raises QualityError if a gain is off by more than `max_factor`, or no number.
        """
        constants = self.constants.moved(step)
        if not np.abs(constants.log_gain).max() < np.log(max_factor):  # NaN neither
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

    Raises QualityError if no constants of any such sensor explain the readings.
    """
    found, sizes = _fitted(_State.first(segments, robot, imu, start), None)
    if not any(deflection.significance > SIGNIFICANT for deflection in found.deflections):
        return found
    return _fitted(_State.first(segments, robot, imu, found.constants), sizes)[0]


def _fitted(
    state: _State,
    sizes: Sizes | None,
    *,
    rounds: int = 25,
    plain: int = 2,
    freeze: int = 5,
    settled: float = 0.1,
    first_size: float = 10.0,
) -> tuple[Fit, Sizes]:
    """Fit with the noise of raw readings, or from sizes on that are renewed in every round."""
    # The first `plain` of the `rounds` have no robust weights, those behind `freeze` the same. The
    # fit ends with a step of `settled` standard errors. Deflections are looked for from
    # `first_size` rad/s^2 of a node.
    change, fixed = np.inf, None
    for number in range(rounds):
        sigma = state.noise_scale()
        robust = sigma if number >= plain else np.full(len(sigma), np.inf)
        reductions = state.reductions(robust, sizes, fixed)
        if number == freeze:  # weights that jump to and fro would keep the fit from settling
            fixed = [r.linear.weights for r in reductions]
        step, information, inner = _solve(reductions, state)
        covariance = _inverse(information)
        change = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        share = 1.0 if sizes is None or number < freeze else 0.5  # whole ones may jump to and fro
        state = state.moved(share * _limited(step), share, reductions, inner)
        state = replace(state, widths=_renewed(state, covariance, inner))
        if sizes is not None:
            sizes = renewed([r.linear for r in reductions], sizes)
        if number > freeze and change < settled:
            break
    reductions = state.reductions(state.noise_scale(), sizes, None)
    linear = [r.linear for r in reductions]
    kinds, joints = kinds_of(state.imu).max() + 1, state.imu.after_joint + 1
    sizes = renewed(linear, sizes or Sizes(np.ones(kinds), np.full(joints, first_size)))
    fit = _finished(reductions, state, converged=change < settled)
    return replace(fit, deflections=deflections(linear, sizes)), sizes


@dataclass(frozen=True)
class _Inner:
    """How a segment's own border follows the constants: own = free - follow @ step."""

    free: Array
    follow: Array
    covariance: Array

    def through(self, columns: Array) -> Array:
        """Columns (..., b) of the border in the constants alone, (..., p)."""
        p = self.follow.shape[1]
        return np.asarray(columns[..., :p] - columns[..., p:] @ self.follow)


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
        gl = r.g[p:] - weights * np.concatenate([own.bias, own.offset])
        cover = _inverse(r.S[p:, p:] + np.diag(weights))
        inner.append(_Inner(cover @ gl, cover @ r.S[p:, :p], cover))
        information = information + inner[-1].through(r.S[:p])
        gradient = gradient + r.g[:p] - inner[-1].follow.T @ gl
    information = 0.5 * (information + information.T)
    step = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
    return step, information, inner


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _limited(step: Array, *, max_turn: float = 0.3) -> Array:
    turn = float(np.linalg.norm(step[:3]))
    return step * min(1.0, max_turn / max(turn, 1e-12))


def _moved(own: Local, reduction: Reduced, step: Array, inner: _Inner, share: float) -> Local:
    change = share * inner.free - inner.follow @ step
    moved = share * reduction.free - reduction.back @ np.concatenate([step, change])
    c = len(own.bias)
    trajectory = own.trajectory + moved.reshape(own.trajectory.shape)
    return Local(trajectory, own.bias + change[:c], own.offset + change[c:])


def _renewed(state: _State, covariance: Array, inner: list[_Inner]) -> Widths:
    """Widths of the priors, per kind of sensor."""
    constants, locals_, widths = state.constants, state.locals_, state.widths
    c, k = len(constants.bias), channels_of(state.imu)[2]
    gain_open, tilt_open = np.split(np.diag(covariance)[7 + c :], [c])
    drift = np.array([own.bias for own in locals_])
    drift_open = np.array([np.diag(i.covariance)[:c] for i in inner])
    for own in (slice(0, k), slice(k, c)):
        size = own.stop - own.start
        if size >= FEW:
            gains = constants.log_gain[own], gain_open[own], widths.gain[own]
            widths.gain[own] = next_width(*gains)
            tilts = constants.tilt[own], tilt_open.reshape(c, 2)[own], widths.tilt[own][:, None]
            widths.tilt[own] = next_width(*tilts)
        if size and len(locals_) > 1:
            widths.drift[own] = next_width(drift[:, own], drift_open[:, own], widths.drift[own])
    return widths


def _finished(reductions: list[Reduced], state: _State, *, converged: bool) -> Fit:
    _, information, inner = _solve(reductions, state)
    model = _inverse(information)
    blocks, own_share = [], np.zeros_like(model)
    for r, i in zip(reductions, inner, strict=True):
        blocks.append(_scores(r, i))
        precision = own_precision(r.linear.segment, state.widths)
        own_share += i.follow.T @ (precision[:, None] * i.follow)
    return Fit(
        constants=state.constants,
        covariance=_widened(model, np.concatenate(blocks), own_share, state.widths, state.imu),
        prior=prior_of(state.widths),
        kept=sum(int(r.linear.used.sum()) for r in reductions),
        outliers=sum(int(r.linear.outliers.sum()) for r in reductions),
        converged=converged,
        holdout=_left_out(reductions, inner, information),
    )


def _scores(
    reduction: Reduced, inner: _Inner, *, block_s: float = 0.25, block_periods: float = 4.0
) -> Array:
    """Scores (blocks, p) of a segment."""
    linear, segment = reduction.linear, reduction.linear.segment
    readings, encoders, jerk = effective(reduction)
    length = max(block_s, block_periods / segment.cutoff_hz)
    block = (np.arange(segment.samples) * segment.spacing / length).astype(int)
    out = np.zeros((block[-1] + 1, inner.follow.shape[1]))
    np.add.at(out, block, np.einsum("nc,ncp->np", linear.r, inner.through(readings)))
    parts = zip(segment.encoders, encoders, linear.encoder_residuals, strict=True)
    for rows, columns, off in parts:
        at = np.clip(rows.at + 1 - 4, 0, segment.samples - 1)
        pull = (rows.information * off)[:, None] * inner.through(columns)
        np.add.at(out, block[at], pull)
    at = np.clip(np.arange(len(jerk)) - 2, 0, segment.samples - 1)
    pull = linear.jerk_residual / segment.jerk**2
    np.add.at(out, block[at], np.einsum("nm,nmp->np", pull, inner.through(jerk)))
    return out


def _widened(model: Array, scores: Array, own: Array, widths: Widths, imu: Imu) -> Array:
    """The model's covariance, each standard error at least that of the scores' own variance."""
    count = len(scores)
    share = count / max(count - 5.0, 0.5 * count)
    gauge = gauge_information(imu, len(widths.gain), len(model))
    omega = share * scores.T @ scores + own + np.diag(prior_of(widths) ** -2.0) + gauge
    seen = model @ omega @ model
    factor = np.sqrt(np.maximum(np.diag(seen) / np.diag(model), 1.0))
    return np.asarray(model * np.outer(factor, factor))


def _left_out(reductions: list[Reduced], inner: list[_Inner], information: Array) -> float | None:
    """RMS of what each log reads beyond the prediction by all the others, over the fit's own."""
    # Both are whitened residuals after each log's own trajectory; one means that the constants
    # carry over to a log that they have not seen. What only one log shows cannot be predicted by
    # the others and does not count.
    logs = {r.linear.segment.log for r in reductions}
    if len(logs) < 2:
        return None
    p = len(information)
    total, before = 0.0, 0.0
    for log in sorted(logs):
        pairs = zip(reductions, inner, strict=True)
        members = [(r, i) for r, i in pairs if r.linear.segment.log == log]
        S, g = np.zeros((p, p)), np.zeros(p)
        for r, i in members:
            S += i.through(r.S[:p])
            g += r.g[:p] - i.follow.T @ r.g[p:]
        step = -without(information, S, g)
        for r, i in members:
            linear = r.linear
            moved = (linear.J.reshape(*linear.r.shape, -1) @ _followed(r))[..., 0]
            settled = linear.r - moved
            total += float(np.sum((settled - i.through(effective(r)[0]) @ step) ** 2))
            before += float(np.sum(settled**2))
    return float(np.sqrt(total / max(before, 1e-12)))


def without(information: Array, own: Array, gradient: Array, *, min_others: float = 0.1) -> Array:
    """Step (p,) from one log's gradient by the others' information.

    Directions of which the others have less than the share `min_others` stay.
    """
    factor = np.linalg.cholesky(information)
    inner = np.linalg.solve(factor, np.linalg.solve(factor, own).T)
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    others = 1.0 - share
    along = directions.T @ np.linalg.solve(factor, gradient)
    along = np.where(others > min_others, along / np.maximum(others, min_others), 0.0)
    return np.asarray(np.linalg.solve(factor.T, directions @ along), dtype=np.float64)


def _followed(reduction: Reduced) -> Array:
    """What the trajectory still moves at rest constants: (N, 3 m, 1), zero at the minimum."""
    segment = reduction.linear.segment
    free = reduction.free.reshape(segment.samples + 2 * REACH, len(segment.moving))
    return at_samples(segment, free).reshape(segment.samples, -1, 1)
