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
from seqid_cli.imu.calibration import normal_equations, sensor_model
from seqid_cli.imu.calibration.deflection import (
    SIGNIFICANT,
    deflections,
    renewed,
)
from seqid_cli.imu.calibration.normal_equations import Local, Reduced, Sizes
from seqid_cli.imu.calibration.segments import Segment
from seqid_cli.imu.calibration.sensor_model import Constants, Widths
from seqid_cli.params.schema import JointDeflection
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import PER_MEDIAN
from seqid_cli.typing import Array

# Two clocks differ by that much [s/s] if nothing is wrong: by their quartzes.
QUARTZ = 5e-5
# Of a clock's offset [s] and rate [s/s] from log to log: far below what any log shows.
LEAST_CLOCK_WIDTHS = (1e-5, 1e-6)


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Estimated constants of an IMU, with their errors.

    `covariance` (p, p) and the prior standard deviations `prior` (p,) are in the order
    of `sensor_model.Places`. `kept` and `outliers` count readings. `moves` (p, d) are
    the changes of the constants if the arm is one of d others.
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


@dataclass(frozen=True, kw_only=True)
class _State:
    """State of the fit: constants, unknowns of each segment, widths of the priors."""

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
        """Return the state before the first round."""
        count = len(start.bias)
        logs = len(start.logs)
        locals_ = [
            Local(trajectory=segment.start, own=np.zeros(count + len(segment.locked)))
            for segment in segments
        ]
        return cls(
            segments=segments,
            robot=robot,
            imu=imu,
            constants=start,
            locals_=locals_,
            widths=sensor_model.first_widths(count, logs),
        )

    @property
    def prior_std(self) -> Array:
        """The standard deviations (p,) of the priors on the constants."""
        return sensor_model.prior_of(self.widths, len(self.constants.logs))

    @property
    def prior(self) -> Array:
        """The information (p, p) of the priors on the constants."""
        prior = self.prior_std
        return np.diag(prior**-2.0) + sensor_model.gauge_information(
            self.imu, len(prior)
        )

    def noise_scale(self) -> Array:
        """Return the robust standard deviation (C,) of the low-passed residuals."""
        parts = []
        for segment, local in zip(self.segments, self.locals_, strict=True):
            residual = normal_equations.residual(
                segment, self.robot, self.imu, self.constants, local
            )
            parts.append(np.where(residual.good, residual.value, np.nan))
        scale = PER_MEDIAN * np.nanmedian(np.abs(np.concatenate(parts)), axis=0)
        return np.asarray(np.maximum(np.nan_to_num(scale, nan=1.0), 1e-6))

    def reductions(
        self, sigma: Array, sizes: Sizes | None, weights: Sequence[Array] | None
    ) -> list[Reduced]:
        """Return the linear equations of each segment in the constants alone."""
        reductions = []
        for k, (segment, local) in enumerate(
            zip(self.segments, self.locals_, strict=True)
        ):
            linear = normal_equations.linearise(
                segment,
                self.robot,
                self.imu,
                self.constants,
                local,
                sigma,
                sizes,
                weights[k] if weights else None,
            )
            reduced = normal_equations.reduced(linear, local, self.widths.drift)
            reductions.append(reduced)
        return reductions

    def solved(self, reductions: list[Reduced]) -> tuple[Array, Array]:
        """Return the step (p,) of the constants and their information (p, p)."""
        gradient = -self.constants.values / self.prior_std**2
        information = self.prior
        for r in reductions:
            places = r.linear.places
            gradient[places] += r.gradient
            information[np.ix_(places, places)] += r.information
        information = 0.5 * (information + information.T)
        step = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        return step, information

    def moved(
        self,
        step: Array,
        share: float,
        reductions: list[Reduced],
        *,
        max_factor: float = 10.0,
    ) -> "_State":
        """Return the state after a step of the constants.

        Raises QualityError if a gain is off by `max_factor` or more.
        """
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
        pairs = zip(reductions, self.locals_, strict=True)
        locals_ = [r.moved(local, step, share) for r, local in pairs]
        return replace(self, constants=constants, locals_=locals_)


def fit_constants(
    segments: list[Segment],
    robot: Robot,
    imu: Imu,
    start: Constants,
    others: Sequence[Robot] = (),
) -> Fit:
    """Refine the constants from a start nearby.

    Where a joint deflects, the fit is repeated with the deflection as noise.

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
    """Fit with the noise of raw readings, or with sizes that every round renews."""
    # The first `plain` of the `rounds` have no robust weights, those behind `freeze`
    # the same. The fit ends with a step of `settled` standard errors; none turns by
    # more than `max_turn` rad. Deflections are looked for from `first_size` rad/s^2 of
    # a node.
    change = np.inf
    fixed = None
    for number in range(rounds):
        sigma = state.noise_scale()
        robust = sigma if number >= plain else np.full(len(sigma), np.inf)
        reductions = state.reductions(robust, sizes, fixed)
        # weights that jump to and fro would keep the fit from settling
        if number == freeze:
            fixed = [r.linear.weights for r in reductions]
        step, information = state.solved(reductions)
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        # Where all logs have one clock, their own changes shrink for many rounds.
        shared = slice(state.constants.places.shared)
        relative = np.abs(step) / np.sqrt(np.diag(covariance))
        change = float(np.max(relative[shared]))
        # Whole steps may jump to and fro once the sizes change with them.
        share = 1.0 if sizes is None or number < freeze else 0.5
        limit = min(1.0, max_turn / max(float(np.linalg.norm(step[:3])), 1e-12))
        state = state.moved(share * limit * step, share, reductions)
        # A clock taken for off in one round and for right in the next would keep the
        # fit from settling.
        widths = _renewed(state, covariance, reductions, decides=number < freeze)
        state = replace(state, widths=widths)
        if sizes is not None:
            sizes = renewed([r.linear for r in reductions], sizes)
        if number > freeze and change < settled:
            break
    reductions = state.reductions(state.noise_scale(), sizes, None)
    linear = [r.linear for r in reductions]
    moves = _moves(state, sizes, reductions, others)
    first = Sizes(
        np.ones(1 + state.imu.gyro), np.full(state.imu.after_joint + 1, first_size)
    )
    sizes = renewed(linear, sizes or first)
    joint_deflections = deflections(linear, sizes, state.robot.joint_names)
    fit = _finished(
        reductions, state, joint_deflections, moves=moves, converged=change < settled
    )
    return fit, sizes


def _moves(
    state: _State,
    sizes: Sizes | None,
    reductions: list[Reduced],
    others: Sequence[Robot],
) -> Array:
    """Return the changes (p, d) of the constants if the arm is one of d others.

    They are one Gauss-Newton step from the estimate, at the weights of `reductions`.
    """
    if not others:
        return np.zeros((state.constants.count, 0))
    sigma = state.noise_scale()
    weights = [reduction.linear.weights for reduction in reductions]
    step_of_arm, _ = state.solved(reductions)
    moves = []
    for robot in others:
        tolerated = replace(state, robot=robot)
        step, _ = tolerated.solved(tolerated.reductions(sigma, sizes, weights))
        moves.append(step - step_of_arm)
    return np.array(moves).T


def _renewed(
    state: _State, covariance: Array, reductions: list[Reduced], *, decides: bool
) -> Widths:
    """Renew the widths of the priors, per kind of sensor, and return them.

    That of the clock's rate is renewed only while it `decides` whether the clock is
    off.
    """
    constants = state.constants
    widths = state.widths
    c = len(constants.bias)
    at = constants.places
    variance = np.diag(covariance)
    gain_open = variance[at.gain]
    tilt_open = variance[at.tilt]
    drift = np.array([local.own[:c] for local in state.locals_])
    drift_open = np.array([np.diag(r.covariance)[:c] for r in reductions])

    accelerometers = slice(0, len(state.imu.axes))
    gyros = slice(len(state.imu.axes), c)
    for kind in (accelerometers, gyros):
        size = len(constants.bias[kind])
        if size >= sensor_model.FEW:
            widths.gain[kind] = sensor_model.next_width(
                constants.log_gain[kind], gain_open[kind], widths.gain[kind]
            )
            widths.tilt[kind] = sensor_model.next_width(
                constants.tilt[kind],
                tilt_open.reshape(c, 2)[kind],
                widths.tilt[kind][:, None],
            )
        if size and len(drift) > 1:
            widths.drift[kind] = sensor_model.next_width(
                drift[:, kind], drift_open[:, kind], widths.drift[kind]
            )
    if decides:
        widths.rate[:] = _rate_width(
            constants.rate, float(variance[at.rate]), float(widths.rate[0])
        )
    if len(constants.logs) > 1:
        clock_open = variance[at.shared :].reshape(-1, 2)
        for k, least in enumerate(LEAST_CLOCK_WIDTHS):
            widths.clock[k] = sensor_model.next_width(
                constants.clock_changes[:, k],
                clock_open[:, k],
                widths.clock[[k]],
                least=least,
            )
    return widths


def _rate_width(
    rate: float, left_open: float, width: float, *, clear: float = 4.0
) -> float:
    """Return the width of the prior of a clock's rate: QUARTZ, unless it is off.

    Parameters
    ----------
    rate, left_open : float
        Its estimate [s/s], and the variance of that.
    width : float
        Present standard deviation of the prior.
    clear : float
        Standard errors of what the logs alone show, from which on the clock is off.
    """
    # What the logs alone show, without the prior. Many clocks are right and a few are
    # far off: a width in between would let chance pass for a small drift.
    by_logs = max(1.0 / left_open - width**-2.0, 1e-6)
    shown = rate / (left_open * by_logs)
    is_off = abs(shown) * np.sqrt(by_logs) > clear
    return max(abs(shown), QUARTZ) if is_off else QUARTZ


def _finished(
    reductions: list[Reduced],
    state: _State,
    joint_deflections: list[JointDeflection],
    *,
    moves: Array,
    converged: bool,
) -> Fit:
    """Return the fit with standard errors, from the equations at its end."""
    _, information = state.solved(reductions)
    local_prior = np.zeros_like(information)
    for r in reductions:
        of_log = np.ix_(r.linear.places, r.linear.places)
        local_prior[of_log] += (r.follow.T * r.precision) @ r.follow
    # The model's covariance, each standard error at least that of the scores' own
    # variance: over blocks of time, and over whole logs, since what bends does so alike
    # throughout a move.
    model = np.asarray(np.linalg.inv(information))
    blocks = [_scores(r, len(model)) for r in reductions]
    largest = np.diag(model)
    for scores, parameters in (
        (np.concatenate(blocks), 5.0),
        (_by_log(reductions, blocks), 1.0),
    ):
        count = len(scores)
        share = count / max(count - parameters, 0.5 * count)
        inner = share * scores.T @ scores + (state.prior + local_prior)
        covariance = model @ inner @ model
        largest = np.maximum(largest, np.diag(covariance))
    factor = np.sqrt(largest / np.diag(model))
    return Fit(
        constants=state.constants,
        covariance=model * np.outer(factor, factor),
        prior=state.prior_std,
        kept=sum(int((r.linear.weights > 0).sum()) for r in reductions),
        outliers=sum(int(r.linear.outliers.sum()) for r in reductions),
        converged=converged,
        holdout=_left_out(reductions, information),
        deflections=joint_deflections,
        moves=moves,
    )


def _by_log(reductions: list[Reduced], blocks: list[Array]) -> Array:
    """Sum the scores (blocks, p) of each log's segments: (logs, p)."""
    logs = [r.linear.segment.log for r in reductions]
    sums = [scores.sum(axis=0) for scores in blocks]
    log_scores = []
    for number in sorted(set(logs)):
        of_log = [total for log, total in zip(logs, sums, strict=True) if log == number]
        log_scores.append(np.sum(of_log, axis=0))
    return np.array(log_scores)


def _scores(
    of: Reduced, p: int, *, block_s: float = 0.25, block_periods: float = 4.0
) -> Array:
    """Return the scores (blocks, p) of a segment, summed over blocks of time."""
    linear = of.linear
    segment = linear.segment
    length = max(block_s, block_periods / segment.cutoff_hz)
    block = (np.arange(segment.samples) * segment.spacing / length).astype(int)
    out = np.zeros((block[-1] + 1, of.follow.shape[1]))
    np.add.at(out, block, np.einsum("nc,ncp->np", linear.r, of.readings()))
    rows = of.through(-(segment.rows @ of.back))
    np.add.at(
        out, block[segment.at], (segment.information * linear.off)[:, None] * rows
    )
    scores = np.zeros((len(out), p))
    scores[:, linear.places] = out
    return scores


def _left_out(reductions: list[Reduced], information: Array) -> float | None:
    """Return the RMS of left-out logs' residuals, relative to that of the fit."""
    # Each log is left out in turn and predicted by all the others. Both residuals are
    # whitened, and the log's own trajectory is fitted. A ratio of one means that the
    # constants carry over to a log that they have not seen. Directions that only one
    # log shows do not count.
    logs = sorted({r.linear.segment.log for r in reductions})
    if len(logs) < 2:
        return None
    p = len(information)
    total = 0.0
    before = 0.0
    for log in logs:
        members = [r for r in reductions if r.linear.segment.log == log]
        S = np.zeros((p, p))
        g = np.zeros(p)
        for r in members:
            places = r.linear.places
            S[np.ix_(places, places)] += r.information
            g[places] += r.through(r.g)
        step = -without(information, S, g)
        for r in members:
            # The trajectory may still move at fixed constants, as the fit is not quite
            # at its minimum.
            settled = r.linear.r - r.followed(r.free[:, None])[..., 0]
            of_log = step[r.linear.places]
            total += float(np.sum((settled - r.readings() @ of_log) ** 2))
            before += float(np.sum(settled**2))
    return float(np.sqrt(total / max(before, 1e-12)))


def without(
    information: Array, own: Array, gradient: Array, *, min_others: float = 0.1
) -> Array:
    """Return the step (p,) from one log's gradient by the others' information."""
    # Directions of which the others have less than the share `min_others` stay.
    factor = np.linalg.cholesky(information)
    inner = np.linalg.solve(factor, np.linalg.solve(factor, own).T)
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    others = 1.0 - share
    along = directions.T @ np.linalg.solve(factor, gradient)
    along = np.where(others > min_others, along / np.maximum(others, min_others), 0.0)
    return np.asarray(np.linalg.solve(factor.T, directions @ along), dtype=np.float64)
