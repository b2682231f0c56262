"""Joint nonlinear least squares for an IMU's constants over all segments.

Gauss-Newton with Tukey's weights. Gains, tilts and the changes of a bias from log to
log have normal priors whose widths come from the data (empirical Bayes: the mean square
of the estimates plus what the data leave open), so good sensors lend their strength to
the mounting and bad ones do not. Where a joint before the IMU deflects, the
accelerations by which it does have the size of the largest likelihood (`deflection`).
Standard errors are the larger of the model's own and those of the scores' long-run
variance, summed over blocks of time that may be dependent within.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.imu_calibration import normal_equations, sensor_model
from seqid_cli.identify.imu_calibration.deflection import (
    SIGNIFICANT,
    deflections,
    renewed,
)
from seqid_cli.identify.imu_calibration.normal_equations import Local, Reduced, Sizes
from seqid_cli.identify.imu_calibration.segments import Segment
from seqid_cli.identify.imu_calibration.sensor_model import Constants, Widths
from seqid_cli.params.schema import JointDeflection
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Constants, `covariance` (p, p) in their order, prior deviations, counts of readings.

    `moves` (p, d) are what the constants change by if the arm is one of d others.
    """

    constants: Constants
    covariance: Array
    prior: Array
    kept: int
    outliers: int
    converged: bool
    holdout: float | None
    deflections: list[JointDeflection]
    moves: Array


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
    def first(
        cls, segments: list[Segment], robot: Robot, imu: Imu, start: Constants
    ) -> "_State":
        count = len(start.bias)
        locals_ = [Local(s.start, np.zeros(count + len(s.locked))) for s in segments]
        return cls(
            segments, robot, imu, start, locals_, sensor_model.first_widths(count)
        )

    @property
    def prior(self) -> Array:
        """Information (p, p) of the priors on the constants."""
        prior = sensor_model.prior_of(self.widths)
        return np.diag(prior**-2.0) + sensor_model.gauge_information(
            self.imu, len(prior)
        )

    def noise_scale(self) -> Array:
        """Robust standard deviation (C,) of the low-passed residuals."""
        parts = []
        for segment, own in zip(self.segments, self.locals_, strict=True):
            at = segment, self.robot, self.imu, self.constants, own
            r, good, *_ = normal_equations.residual(*at)
            parts.append(np.where(good, r, np.nan))
        scale = PER_MEDIAN * np.nanmedian(np.abs(np.concatenate(parts)), axis=0)
        return np.asarray(np.maximum(np.nan_to_num(scale, nan=1.0), 1e-6))

    def reductions(
        self, sigma: Array, sizes: Sizes | None, weights: Sequence[Array] | None
    ) -> list[Reduced]:
        """The linear equations of each segment in the constants alone."""
        found = []
        for k, (segment, local) in enumerate(
            zip(self.segments, self.locals_, strict=True)
        ):
            at = segment, self.robot, self.imu, self.constants, local
            own = weights[k] if weights else None
            linear = normal_equations.linearise(*at, sigma, sizes, own)
            found.append(normal_equations.reduced(linear, local, self.widths.drift))
        return found

    def solved(self, reductions: list[Reduced]) -> tuple[Array, Array]:
        """Step (p,) of the constants and their information (p, p)."""
        first = -self.constants.values / sensor_model.prior_of(self.widths) ** 2
        gradient = sum((r.gradient for r in reductions), first)
        information = sum((r.information for r in reductions), self.prior)
        information = 0.5 * (information + information.T)
        return (
            np.asarray(np.linalg.solve(information, gradient), dtype=np.float64),
            information,
        )

    def moved(
        self,
        step: Array,
        share: float,
        found: list[Reduced],
        *,
        max_factor: float = 10.0,
    ) -> "_State":
        """The state after a step of constants; QualityError if a gain is off by `max_factor`."""
        constants = self.constants.moved(step)
        if not np.abs(constants.log_gain).max() < np.log(max_factor):  # NaN neither
            raise QualityError(
                "its readings are not those of a sensor on that link: no gain explains"
                " them",
                hint=(
                    "Check gravity in the robot file, units and axes of the IMU,"
                    " after_joint and the order of the joints (seqid inspect LOG... -r"
                    " ROBOT)."
                ),
                where=self.imu.name,
            )
        pairs = zip(found, self.locals_, strict=True)
        locals_ = [r.moved(local, step, share) for r, local in pairs]
        return replace(self, constants=constants, locals_=locals_)


def fit_constants(
    segments: list[Segment],
    robot: Robot,
    imu: Imu,
    start: Constants,
    others: Sequence[Robot] = (),
) -> Fit:
    """Refine the constants from a start nearby; once more where a joint deflects, as noise.

    Parameters
    ----------
    segments : list of Segment
        Stretches of logs in which joints before the IMU move.
    robot : Robot
    imu : Imu
    start : Constants
        Near the constants.
    others : sequence of Robot
        Arms that this one may be as well, within the tolerances of its robot file.
    """
    fit, sizes = _fitted(_State.first(segments, robot, imu, start), None, others)
    if any(deflection.significance > SIGNIFICANT for deflection in fit.deflections):
        second = _State.first(segments, robot, imu, fit.constants)
        fit, _ = _fitted(second, sizes, others)
    return fit


def _fitted(
    state: _State,
    sizes: Sizes | None,
    others: Sequence[Robot],
    *,
    rounds: int = 25,
    plain: int = 2,
    freeze: int = 5,
    settled: float = 0.1,
    first_size: float = 10.0,
    max_turn: float = 0.3,
) -> tuple[Fit, Sizes]:
    """Fit with the noise of raw readings, or from sizes on that are renewed in every round."""
    # The first `plain` of the `rounds` have no robust weights, those behind `freeze`
    # the same. The fit ends with a step of `settled` standard errors; none turns by
    # more than `max_turn` rad. Deflections are looked for from `first_size` rad/s^2 of
    # a node.
    change, fixed = np.inf, None
    for number in range(rounds):
        sigma = state.noise_scale()
        robust = sigma if number >= plain else np.full(len(sigma), np.inf)
        reductions = state.reductions(robust, sizes, fixed)
        # weights that jump to and fro would keep the fit from settling
        if number == freeze:
            fixed = [r.linear.weights for r in reductions]
        step, information = state.solved(reductions)
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        change = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        # whole ones may jump to and fro
        share = 1.0 if sizes is None or number < freeze else 0.5
        limit = min(1.0, max_turn / max(float(np.linalg.norm(step[:3])), 1e-12))
        state = state.moved(share * limit * step, share, reductions)
        state = replace(state, widths=_renewed(state, covariance, reductions))
        if sizes is not None:
            sizes = renewed([r.linear for r in reductions], sizes)
        if number > freeze and change < settled:
            break
    reductions = state.reductions(state.noise_scale(), sizes, None)
    linear = [r.linear for r in reductions]
    moves = _moves(state, sizes, [part.weights for part in linear], others)
    first = Sizes(
        np.ones(1 + state.imu.gyro), np.full(state.imu.after_joint + 1, first_size)
    )
    sizes = renewed(linear, sizes or first)
    found = deflections(linear, sizes, state.robot.joint_names)
    fit = _finished(reductions, state, found, converged=change < settled)
    return replace(fit, moves=moves), sizes


def _moves(
    state: _State,
    sizes: Sizes | None,
    weights: Sequence[Array],
    others: Sequence[Robot],
) -> Array:
    """Return what the constants change by (p, d) if the arm is one of d others.

    One step of Gauss and Newton from the estimate tells it, at the same weights.
    """
    if not others:
        return np.zeros((state.constants.count, 0))
    sigma = state.noise_scale()
    here, _ = state.solved(state.reductions(sigma, sizes, weights))
    moves = []
    for robot in others:
        other = replace(state, robot=robot)
        there, _ = other.solved(other.reductions(sigma, sizes, weights))
        moves.append(there - here)
    return np.array(moves).T


def _renewed(state: _State, covariance: Array, reductions: list[Reduced]) -> Widths:
    """Widths of the priors, per kind of sensor."""
    constants, widths, c = state.constants, state.widths, len(state.constants.bias)
    gain_open, tilt_open = np.split(np.diag(covariance)[7 + c : -1], [c])
    drift = np.array([own.own[:c] for own in state.locals_])
    drift_open = np.array([np.diag(r.covariance)[:c] for r in reductions])
    for own in (slice(0, len(state.imu.axes)), slice(len(state.imu.axes), c)):
        size = len(constants.bias[own])
        if size >= sensor_model.FEW:
            gains = constants.log_gain[own], gain_open[own], widths.gain[own]
            widths.gain[own] = sensor_model.next_width(*gains)
            tilts = (
                constants.tilt[own],
                tilt_open.reshape(c, 2)[own],
                widths.tilt[own][:, None],
            )
            widths.tilt[own] = sensor_model.next_width(*tilts)
        if size and len(drift) > 1:
            drifts = drift[:, own], drift_open[:, own], widths.drift[own]
            widths.drift[own] = sensor_model.next_width(*drifts)
    return widths


def _finished(
    reductions: list[Reduced],
    state: _State,
    found: list[JointDeflection],
    *,
    converged: bool,
) -> Fit:
    _, information = state.solved(reductions)
    own = sum((r.follow.T * r.precision) @ r.follow for r in reductions)
    # The model's covariance, each standard error at least that of the scores' own
    # variance: over blocks of time, and over whole logs, since what bends does so alike
    # throughout a move.
    model = np.asarray(np.linalg.inv(information))
    blocks = [_scores(r) for r in reductions]
    largest = np.diag(model)
    for scores, parameters in (
        (np.concatenate(blocks), 5.0),
        (_by_log(reductions, blocks), 1.0),
    ):
        count = len(scores)
        share = count / max(count - parameters, 0.5 * count)
        seen = model @ (share * scores.T @ scores + (state.prior + own)) @ model
        largest = np.maximum(largest, np.diag(seen))
    factor = np.sqrt(largest / np.diag(model))
    return Fit(
        constants=state.constants,
        covariance=model * np.outer(factor, factor),
        prior=sensor_model.prior_of(state.widths),
        kept=sum(int((r.linear.weights > 0).sum()) for r in reductions),
        outliers=sum(int(r.linear.outliers.sum()) for r in reductions),
        converged=converged,
        holdout=_left_out(reductions, information),
        deflections=found,
        moves=np.zeros((len(model), 0)),
    )


def _by_log(reductions: list[Reduced], blocks: list[Array]) -> Array:
    """Sum the scores (blocks, p) of each log's segments: (logs, p)."""
    logs = [r.linear.segment.log for r in reductions]
    sums = [scores.sum(axis=0) for scores in blocks]
    return np.array(
        [
            np.sum(
                [total for log, total in zip(logs, sums, strict=True) if log == one],
                axis=0,
            )
            for one in sorted(set(logs))
        ]
    )


def _scores(of: Reduced, *, block_s: float = 0.25, block_periods: float = 4.0) -> Array:
    """Scores (blocks, p) of a segment."""
    linear, segment = of.linear, of.linear.segment
    length = max(block_s, block_periods / segment.cutoff_hz)
    block = (np.arange(segment.samples) * segment.spacing / length).astype(int)
    out = np.zeros((block[-1] + 1, of.follow.shape[1]))
    np.add.at(out, block, np.einsum("nc,ncp->np", linear.r, of.readings()))
    rows = of.through(-(segment.rows @ of.back))
    np.add.at(
        out, block[segment.at], (segment.information * linear.off)[:, None] * rows
    )
    return out


def _left_out(reductions: list[Reduced], information: Array) -> float | None:
    """RMS of what each log reads beyond the prediction by all the others, over the fit's own."""
    # Both are whitened residuals after each log's own trajectory; one means that the
    # constants carry over to a log that they have not seen. What only one log shows
    # does not count.
    logs = sorted({r.linear.segment.log for r in reductions})
    if len(logs) < 2:
        return None
    p, total, before = len(information), 0.0, 0.0
    for log in logs:
        members = [r for r in reductions if r.linear.segment.log == log]
        S = sum((r.information for r in members), np.zeros((p, p)))
        g = sum((r.g[:p] - r.follow.T @ r.g[p:] for r in members), np.zeros(p))
        step = -without(information, S, g)
        for r in members:
            # What the trajectory still moves at rest constants is nothing at the
            # minimum.
            settled = r.linear.r - r.followed(r.free[:, None])[..., 0]
            total += float(np.sum((settled - r.readings() @ step) ** 2))
            before += float(np.sum(settled**2))
    return float(np.sqrt(total / max(before, 1e-12)))


def without(
    information: Array, own: Array, gradient: Array, *, min_others: float = 0.1
) -> Array:
    """Step (p,) from one log's gradient by the others' information."""
    # Directions of which the others have less than the share `min_others` stay.
    factor = np.linalg.cholesky(information)
    inner = np.linalg.solve(factor, np.linalg.solve(factor, own).T)
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    others = 1.0 - share
    along = directions.T @ np.linalg.solve(factor, gradient)
    along = np.where(others > min_others, along / np.maximum(others, min_others), 0.0)
    return np.asarray(np.linalg.solve(factor.T, directions @ along), dtype=np.float64)
