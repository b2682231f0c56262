"""The controller of one joint by least squares, its delays by search.

Given both delays the law is linear (`equations`). They are searched on a grid first,
which has no wrong minimum to fall into, then by the simplex. Parts that the logs cannot
show are left out before; parts that are not there are taken out one by one.

Rows at the limit of the torque follow another law. A fit without the largest torques
predicts what would be beyond it; where that is much more than was ever measured, there
is a limit, and rows near it are left out.

Errors are those of Gauss-Newton with the delays as unknowns beside the gains, widened
by blocks of a second (sandwich): what is left is no white noise. What the choice of the
band does is no noise at all. The fit is made once more with half of the cut-off, and
the change counts as an error of its own kind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import minimize, minimize_scalar

from seqid_cli.drive.equations import (
    ACCELERATION_FEEDFORWARD,
    DERIVATIVE,
    GRAVITY,
    INTEGRAL,
    PARTS,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
    Delays,
    Equations,
    JointLaw,
    own_shares,
)
from seqid_cli.drive.settings import DriveSettings, TermSettings
from seqid_cli.drive.signals import DriveSignals, command_at, shifted
from seqid_cli.inspect.channels.commands import FOLLOWED, lag_between
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Array, Mask

FEWEST_ROWS = 40  # of all logs, for a controller to be fitted
FEEDFORWARD = (VELOCITY_FEEDFORWARD, ACCELERATION_FEEDFORWARD)
# The largest torques are left out of the first fit of all; see the module's text.
TOP_SHARE = 0.9
# A torque that would be so many times the largest one that was measured is cut off.
BEYOND = 1.1
BEYOND_ROWS = 5  # that are, for a limit to be there
NEAR_LIMIT = 0.97  # of a limit, from which rows follow another law
GUARD_S = 0.03  # on either side of them
# The shortest time at a speed that is a limit and no peak.
PLATEAU_S = 0.1
# Steps in which delays are moved for their columns [s]: much less than a period of the
# band, much more than rounding.
STEP_S = 2e-4
# Commands that step are looked for within so many rows of the grid's best, in steps of
# a share of a row; what leaves so little more is as good.
HELD_ROWS = 1.5
HELD_STEP = 0.25
AS_GOOD = 1e-3
# A command is looked for as late as this [s]: loops that are slower are none.
MAX_DELAY_S = 0.25
# By so much rows, commands and torque may be late against each other [s]: half a
# step of a fast controller. No residual shows it.
LATE_S = 1e-4
# The torque's channel is looked for as late as this [s]: filters of a drive take less.
MAX_LAG_S = 0.02
# Share of a part's column that no other explains: with less, logs cannot show the part.
MIN_OWN_SHARE = 0.02
# Share of what is left that a part takes away at least: less is the form of the law.
MIN_GAIN = 0.005
# Steps of the grid over the command's delay, and of that over the torque's lag.
GRID_S = 5e-3
LAG_GRID = 3
# Of the torque above the band: a course that leaves so much less is the right one.
CLEARLY = 0.9
# Of the RMS speed: slower rows are near a reversal, where friction is any torque.
SLOW = 0.2


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The limit of a torque [N m], and where it was reached."""

    value: float
    std_error: float
    rows: int


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """The controller of a joint.

    Attributes
    ----------
    names : tuple of str
        The parts that are there.
    values, std_errors : dict of str to float
        Of these, of `command_delay` and of `torque_lag`.
    own_shares : dict of str to float
        Share of each part's column that no other explains, before any was taken out.
    refused : dict of str to float
        Standard errors of parts that were taken out.
    delays : Delays
    course : str
        What commands do between two stamps.
    course_is_known : bool
        Whether the logs tell it.
    left : float
        Share of the torque's RMS that is left.
    rmse : float
        N m.
    rows : int
    offset : float
        N m, mean of all logs.
    limit : Limit, optional
    speed_limit : Limit, optional
        rad/s.
    largest_torque, largest_speed : float
        N m, rad/s, that the logs show.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    std_errors: dict[str, float]
    own_shares: dict[str, float]
    refused: dict[str, float]
    delays: Delays
    course: str
    course_is_known: bool
    left: float
    rmse: float
    rows: int
    offset: float
    limit: Limit | None
    speed_limit: Limit | None
    largest_torque: float
    largest_speed: float


@dataclass(frozen=True, kw_only=True)
class _Solution:
    """Least squares at some delays."""

    delays: Delays
    theta: Array  # (p,)
    squares: float  # (N m)^2, left over

    def opposes(self, names: Sequence[str]) -> bool:
        """Tell whether the law drives errors back and takes energy away.

        At a wrong delay the opposite may explain a torque as well.
        """
        gains = dict(zip(names, self.theta.tolist(), strict=True))
        return bool(gains[PROPORTIONAL] > 0.0 and gains.get(DERIVATIVE, 0.0) >= 0.0)


def fit_joint(
    logs: Sequence[DriveSignals],
    narrow: Sequence[DriveSignals],
    joint: int,
    settings: DriveSettings,
) -> JointFit | None:
    """Fit the controller of a joint; None where too few samples have a command.

    Parameters
    ----------
    logs, narrow : sequence of DriveSignals
        The logs, and the same with half of the cut-off.
    joint : int
    settings : DriveSettings
    """
    fits = []
    for course in logs[0].commands:
        fit = _fit_course(logs, narrow, joint, course, settings)
        if fit is not None:
            fits.append(fit)
    if len(fits) < 2:
        return fits[0] if fits else None
    return _better_course(logs, joint, fits)


def _better_course(
    logs: Sequence[DriveSignals], joint: int, fits: Sequence[JointFit]
) -> JointFit:
    """Choose between commands that hold and commands that are interpolated.

    Within the band of the fit a held command is one that is half a period late. Above
    it the steps show, in the torque alone.
    """
    if not all(log.measured and log.sent is not None for log in logs):
        return replace(fits[0], course_is_known=False)
    left = [_left_above(logs, joint, fit) for fit in fits]
    best = int(np.argmin(left))
    is_known = left[best] < CLEARLY * max(left)
    return replace(fits[best] if is_known else fits[0], course_is_known=is_known)


def _left_above(logs: Sequence[DriveSignals], joint: int, fit: JointFit) -> float:
    """Return the mean square of the torque above the band that a course leaves."""
    period_s = logs[0].command_period_s
    total = fit.delays.command + fit.delays.torque
    gain = fit.values[PROPORTIONAL]
    best = np.inf
    for delay in total + np.arange(-0.5, 0.5, 0.05) * period_s:
        squares = []
        for log in logs:
            assert log.raw.tau is not None
            command = command_at(log, fit.course, joint, log.raw.t - delay)
            rest = log.raw.tau[:, joint] - gain * command
            lowpass = Lowpass(log.cutoff_hz, log.rate_hz)
            above = rest - lowpass(rest[:, None], log.raw.valid)[:, 0]
            squares.append(above[log.usable[:, joint]] ** 2)
        best = min(best, float(np.mean(np.concatenate(squares))))
    return best


def _fit_course(
    logs: Sequence[DriveSignals],
    narrow: Sequence[DriveSignals],
    joint: int,
    course: str,
    settings: DriveSettings,
) -> JointFit | None:
    """Fit the controller of a joint for what commands do between two stamps."""
    law = JointLaw(
        logs=logs,
        joint=joint,
        course=course,
        used=[_used(log, joint) for log in logs],
        lawful=[log.usable[:, joint] for log in logs],
    )
    largest = max(
        float(np.abs(log.torque[used, joint]).max(initial=0.0))
        for log, used in zip(logs, law.used, strict=True)
    )
    if not largest > 0.0:
        return None

    without_top = replace(law, used=_below(law, law.used, TOP_SHARE * largest))
    first = _search(without_top, _first_names(law))
    if first is None:
        without_top = law
        first = _search(law, _first_names(law))
    if first is None:
        return None
    limit = _limit(law, first, largest)
    if limit is not None:
        law = replace(
            law,
            used=_below(law, law.used, NEAR_LIMIT * limit.value),
            lawful=_below(law, law.lawful, NEAR_LIMIT * limit.value),
        )
        again = _search(law, _first_names(law))
        first = first if again is None else again

    shares = _shares(law, first.delays)
    shown = [name for name, share in shares.items() if share >= MIN_OWN_SHARE]
    if PROPORTIONAL not in shown:
        shown = [PROPORTIONAL]
    # Another law may have another delay: the whole grid once more.
    solution = _search(law, shown)
    if solution is None:
        return None
    names, solution, refused = _without_absent(law, shown, solution, settings)
    return _described(
        law,
        narrow,
        names,
        solution,
        refused,
        shares,
        limit,
        largest,
    )


def _used(log: DriveSignals, joint: int) -> Mask:
    """Return the samples of a log that count for a joint."""
    used = log.usable[:, joint].copy()
    if not log.measured:
        # At rest friction is anything up to its limit.
        speed = np.abs(log.dq[:, joint])
        rms = float(np.sqrt(np.mean(speed[used] ** 2))) if used.any() else 0.0
        used &= log.moving[:, joint] & (speed > SLOW * rms)
    return used


def _first_names(law: JointLaw) -> list[str]:
    """Return the parts by which delays are looked for first."""
    names = [PROPORTIONAL, DERIVATIVE]
    if law.course != "held":
        names.append(VELOCITY_FEEDFORWARD)
    return names


def _below(law: JointLaw, of: Sequence[Mask], limit: float) -> list[Mask]:
    """Return samples of each log without those near or above a torque [N m]."""
    masks = []
    for log, used in zip(law.logs, of, strict=True):
        guard = max(1, round(GUARD_S * log.rate_hz))
        torque = log.raw.tau if log.measured else log.torque
        assert torque is not None
        high = np.abs(torque[:, law.joint]) > limit
        around = np.ones(2 * guard + 1, dtype=np.bool_)
        masks.append(used & ~binary_dilation(high, around))
    return masks


def _solved(law: JointLaw, names: Sequence[str], delays: Delays) -> _Solution | None:
    """Solve for the gains at some delays; None where too few rows are there."""
    equations = law.equations(names, delays)
    if len(equations.y) < FEWEST_ROWS:
        return None
    theta: Array = np.asarray(
        np.linalg.lstsq(equations.X, equations.y, rcond=1e-10)[0], np.float64
    )
    left = equations.y - equations.X @ theta
    # Delays change how many rows there are: the mean counts.
    return _Solution(delays=delays, theta=theta, squares=float(np.mean(left**2)))


def _search(law: JointLaw, names: Sequence[str]) -> _Solution | None:
    """Find both delays on a grid, then by the simplex."""
    lags = np.linspace(0.0, MAX_LAG_S, LAG_GRID)
    if not law.logs[0].measured:
        lags = lags[:1]
    lowest = -law.logs[0].command_period_s
    best: _Solution | None = None
    best_opposes = False
    for lag in lags:
        for delay in np.arange(lowest, _longest_delay(law), GRID_S):
            delays = Delays(command=float(delay), torque=float(lag))
            solution = _solved(law, names, delays)
            if solution is None:
                continue
            opposes = solution.opposes(names)
            is_better = best is None or solution.squares < best.squares
            if (opposes and not best_opposes) or (
                opposes == best_opposes and is_better
            ):
                best = solution
                best_opposes = opposes
    return None if best is None else _refined(law, names, best.delays)


def _longest_delay(law: JointLaw) -> float:
    """Return the longest delay that commands may have [s].

    A loop lags behind what it is given, so that the command is no later than the
    position lags behind it.
    """
    lags = []
    for log in law.logs:
        assert log.raw.command is not None
        lag = lag_between(
            log.raw.command[:, law.joint],
            log.q[:, law.joint],
            log.usable[:, law.joint],
            log.rate_hz,
        )
        if lag is not None and lag.left < FOLLOWED:
            lags.append(lag.seconds + law.logs[0].command_period_s)
    longest = max(lags, default=MAX_DELAY_S)
    return min(max(longest, 2.0 * GRID_S), MAX_DELAY_S)


def _refined(law: JointLaw, names: Sequence[str], start: Delays) -> _Solution:
    """Find both delays between the places of the grid."""
    if law.course == "held":
        return _refined_held(law, names, start)
    measured = law.logs[0].measured
    scale_s = 1e-3

    def at(x: Array) -> Delays:
        lag = float(x[1]) * scale_s if measured else 0.0
        return Delays(command=float(x[0]) * scale_s, torque=lag)

    def squares(x: Array) -> float:
        delays = at(x)
        beyond = max(-delays.torque, delays.torque - 2.0 * MAX_LAG_S)
        if beyond > 0.0:  # the simplex is led back
            inside = Delays(
                command=delays.command,
                torque=float(np.clip(delays.torque, 0.0, None)),
            )
            solution = _solved(law, names, inside)
            worst = np.inf if solution is None else solution.squares
            return float(worst * (1.0 + beyond / scale_s))
        solution = _solved(law, names, delays)
        if solution is None or (start_opposes and not solution.opposes(names)):
            return np.inf
        return solution.squares

    first = _solved(law, names, start)
    start_opposes = first is not None and first.opposes(names)
    x0 = np.array([start.command, start.torque]) / scale_s
    if not measured:
        x0 = x0[:1]
    simplex = np.vstack([x0, x0 + 2.0 * np.eye(len(x0))])
    found = minimize(
        squares,
        x0,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": 1e-3,
            "fatol": 0.0,
            "maxiter": 80,
        },
    )
    x = found.x.copy()
    if measured:
        x[1] = max(x[1], 0.0)
    solution = _solved(law, names, at(x))
    assert solution is not None
    return solution


def _refined_held(law: JointLaw, names: Sequence[str], start: Delays) -> _Solution:
    """Find both delays where commands step: all between two rows is one and the same.

    The middle of what is as good as the best counts.
    """
    row_s = 1.0 / law.logs[0].rate_hz
    around = np.arange(-HELD_ROWS, HELD_ROWS + 1e-9, HELD_STEP) * row_s
    totals = start.command + start.torque + around
    solutions = []
    for total in totals:
        solution = _best_lag(law, names, float(total))
        if solution is not None:
            solutions.append(solution)
    least = min(solution.squares for solution in solutions)
    good = [s for s in solutions if s.squares <= (1.0 + AS_GOOD) * least]
    middle = float(np.mean([s.delays.command + s.delays.torque for s in good]))
    best = min(good, key=lambda s: abs(s.delays.command + s.delays.torque - middle))
    delays = Delays(command=middle - best.delays.torque, torque=best.delays.torque)
    return _solved(law, names, delays) or best


def _best_lag(law: JointLaw, names: Sequence[str], total_s: float) -> _Solution | None:
    """Find the torque's lag where the time from command to torque is given."""

    def at(lag: float) -> _Solution | None:
        delays = Delays(command=total_s - lag, torque=lag)
        return _solved(law, names, delays)

    if not law.logs[0].measured:
        return at(0.0)

    def squares(lag: float) -> float:
        solution = at(lag)
        return np.inf if solution is None else solution.squares

    found = minimize_scalar(
        squares, bounds=(0.0, MAX_LAG_S), method="bounded", options={"xatol": 2e-5}
    )
    return at(float(found.x))


def _limit(law: JointLaw, first: _Solution, largest: float) -> Limit | None:
    """Find the limit of the torque: where more is predicted than was ever measured."""
    names = _first_names(law)
    at_limit = []
    for log, used in zip(law.logs, law.used, strict=True):
        columns, _ = law.columns(log, names, first.delays)
        inside = used & np.isfinite(columns).all(axis=1)
        if not inside.any():
            continue
        predicted = columns @ first.theta
        offset = np.median((log.torque[:, law.joint] - predicted)[inside])
        beyond = inside & (np.abs(predicted + offset) > BEYOND * largest)
        torque = log.raw.tau if log.measured else log.torque
        assert torque is not None
        at_limit.append(np.abs(torque[beyond, law.joint]))
    torques = np.concatenate(at_limit) if at_limit else np.zeros(0)
    # What lies well below belongs to a law that does not hold there, not to a limit.
    high = torques[torques > TOP_SHARE * largest]
    if len(high) < BEYOND_ROWS or len(high) < 0.5 * len(torques):
        return None
    value = float(np.median(high))
    # Neighbouring rows are one reading.
    std_error = float(1.25 * high.std() / np.sqrt(max(1.0, len(high) / 5.0)))
    return Limit(value=value, std_error=std_error, rows=len(high))


def _shares(law: JointLaw, delays: Delays) -> dict[str, float]:
    """Return the share of each part's column that the other parts do not explain."""
    names = [name for name in PARTS if name != INTEGRAL]
    if law.course == "held":
        # A command that steps has no slope for a controller to feed forward.
        names = [name for name in names if name not in FEEDFORWARD]
    elif not law.logs[0].measured:
        # The model's torque is mostly the acceleration, and so is that of a command
        # which the joint follows: this part would stand for the whole controller.
        names.remove(ACCELERATION_FEEDFORWARD)
    shares = own_shares(law.equations(names, delays).X)
    by_name = dict(zip(names, shares.tolist(), strict=True))
    # With an integral every stretch has an offset of its own.
    with_integral = [PROPORTIONAL, DERIVATIVE, INTEGRAL]
    shares = own_shares(law.equations(with_integral, delays).X)
    by_name[INTEGRAL] = float(shares[-1]) if len(shares) else 0.0
    # A joint of which gravity hardly changes has no column to speak of.
    gravity = [np.ptp(log.gravity[:, law.joint]) for log in law.logs]
    torque = [np.ptp(log.torque[:, law.joint]) for log in law.logs]
    if max(gravity) < 0.01 * max(torque):
        by_name[GRAVITY] = 0.0
    return by_name


def _without_absent(
    law: JointLaw,
    shown: Sequence[str],
    solution: _Solution,
    settings: DriveSettings,
) -> tuple[tuple[str, ...], _Solution, dict[str, float]]:
    """Take parts out one by one that are not there; returns their standard errors."""
    names = list(shown)
    refused: dict[str, float] = {}
    while len(names) > 1:
        errors = _errors(law, names, solution)
        sigma = np.abs(solution.theta) / np.maximum(errors[: len(names)], 1e-300)
        order = [k for k in np.argsort(sigma) if names[k] != PROPORTIONAL]
        weakest = int(order[0])
        fewer = [name for k, name in enumerate(names) if k != weakest]
        # The integral changes which rows share an offset: both on the same ones.
        simpler = _refined(law, fewer, solution.delays)
        gain = 1.0 - solution.squares / max(simpler.squares, 1e-300)
        if is_part(float(sigma[weakest]), gain, settings.terms):
            break
        refused[names[weakest]] = float(errors[weakest])
        names = fewer
        solution = simpler
    return tuple(names), solution, refused


def is_part(sigma: float, gain: float, settings: TermSettings) -> bool:
    """Tell whether a part is there.

    Parameters
    ----------
    sigma : float
        Standard errors of its gain from zero.
    gain : float
        Share of what is left that it takes away.
    settings : TermSettings
    """
    return sigma >= settings.min_sigma and gain >= MIN_GAIN


def _errors(law: JointLaw, names: Sequence[str], solution: _Solution) -> Array:
    """Return standard errors (p + 2,) of gains and delays, the lag's last.

    The scatter over blocks counts, not that of rows, which are not independent. What
    the gains move by where rows are late against each other counts as well.
    """
    equations = law.equations(names, solution.delays)
    J = _jacobian(law, names, solution, equations)
    left = equations.y - equations.X @ solution.theta
    blocks = equations.blocks

    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-10)
    scores = np.zeros((int(blocks.max()) + 1, J.shape[1]))
    np.add.at(scores, blocks, (J / scale) * left[:, None])
    n_blocks = max(2, np.count_nonzero(scores.any(axis=1)))
    p = J.shape[1]
    # Few blocks bend the fit towards themselves.
    inflation = n_blocks / max(1.0, n_blocks - p)
    covariance = inverse @ (scores.T @ scores) @ inverse * inflation
    errors = np.zeros(len(names) + 2)
    errors[:p] = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    return np.hypot(errors, _moved_by_stamps(law, names, solution))


def _moved_by_stamps(law: JointLaw, names: Sequence[str], solution: _Solution) -> Array:
    """Return what gains and delays (p + 2,) move by where stamps are off."""
    moves = np.full(len(names) + 2, LATE_S)
    moves[: len(names)] = 0.0
    back_s = -LATE_S if law.course == "held" else 0.0
    moved = solution.delays.moved(torque=LATE_S, command=back_s)
    other = _solved(law, names, moved)
    if other is not None:
        moves[: len(names)] = np.abs(other.theta - solution.theta)
    return moves


def _jacobian(
    law: JointLaw, names: Sequence[str], solution: _Solution, equations: Equations
) -> Array:
    """Return the columns (M, p + 1 or p + 2) of gains and delays."""
    columns = [equations.X]
    # What steps has no slope over its delay; a lag moves the motion alone then.
    steps = law.course == "held"
    moves = [{"command": 0.0 if steps else STEP_S}]
    if law.logs[0].measured:
        moves.append({"torque": STEP_S, "command": -STEP_S if steps else 0.0})
    for move in moves:
        later = law.equations(names, solution.delays.moved(**move))
        earlier = law.equations(
            names, solution.delays.moved(**{k: -v for k, v in move.items()})
        )
        if not len(later.y) == len(earlier.y) == len(equations.y):
            # Rows at an end come and go: the slope is left out.
            columns.append(np.zeros((len(equations.y), 1)))
            continue
        change = (later.X - earlier.X) @ solution.theta / (2.0 * STEP_S)
        columns.append(change[:, None])
    return np.hstack(columns)


def _described(
    law: JointLaw,
    narrow: Sequence[DriveSignals],
    names: tuple[str, ...],
    solution: _Solution,
    refused: dict[str, float],
    shares: dict[str, float],
    limit: Limit | None,
    largest: float,
) -> JointFit:
    """Return the result of a fit, errors widened by what the band does."""
    equations = law.equations(names, solution.delays)
    errors = _errors(law, names, solution)
    # The same law in half of the band, at delays of its own.
    in_half = replace(law, logs=narrow)
    other = _refined(in_half, names, solution.delays)
    change = np.append(
        other.theta - solution.theta,
        [
            other.delays.command - solution.delays.command,
            other.delays.torque - solution.delays.torque,
        ],
    )
    errors = np.hypot(errors, change)

    keys = [*names, "command_delay", "torque_lag"]
    values = np.append(
        solution.theta, [solution.delays.command, solution.delays.torque]
    )
    std_errors = dict(zip(keys, errors.tolist(), strict=True))
    if law.course == "held":
        # The torque of a row says only that a step came since the row before.
        row_error_s = 1.0 / law.logs[0].rate_hz / np.sqrt(12.0)
        std_errors["command_delay"] = float(
            np.hypot(std_errors["command_delay"], row_error_s)
        )
    torque_rms = float(np.sqrt(np.mean(equations.y**2)))
    rmse = float(np.sqrt(solution.squares))
    mean_theta = float(equations.means[:-1] @ solution.theta)
    speeds = [
        float(np.abs(log.dq[used, law.joint]).max(initial=0.0))
        for log, used in zip(law.logs, law.used, strict=True)
    ]
    return JointFit(
        names=names,
        values=dict(zip(keys, values.tolist(), strict=True)),
        std_errors=std_errors,
        own_shares=shares,
        refused=refused,
        delays=solution.delays,
        course=law.course,
        course_is_known=True,
        left=rmse / max(torque_rms, 1e-300),
        rmse=rmse,
        rows=len(equations.y),
        offset=float(equations.means[-1]) - mean_theta,
        limit=limit,
        speed_limit=_speed_limit(law, solution.delays, max(speeds)),
        largest_torque=largest,
        largest_speed=max(speeds),
    )


def _speed_limit(law: JointLaw, delays: Delays, fastest: float) -> Limit | None:
    """Find a limit of the speed: a joint stays at it while its command runs faster.

    Near a peak of its own a joint is as fast for a moment only.
    """
    speeds = []
    for log, used in zip(law.logs, law.lawful, strict=True):
        total = (delays.command + delays.torque) * log.rate_hz
        command = log.commands[law.course].c[:, law.joint]
        asked = np.abs(np.gradient(command)) * log.rate_hz
        asked = np.nan_to_num(shifted(asked, total))
        speed = np.abs(log.dq[:, law.joint])
        at_limit = used & (speed > NEAR_LIMIT * fastest) & (asked > BEYOND * fastest)
        for start, stop in runs(at_limit, len(at_limit)):
            if stop - start >= PLATEAU_S * log.rate_hz:
                speeds.append(speed[start:stop])
    if not speeds:
        return None
    pooled = np.concatenate(speeds)
    return Limit(
        value=float(np.median(pooled)),
        # Each plateau is one reading.
        std_error=float(pooled.std() / np.sqrt(len(speeds))),
        rows=len(pooled),
    )
