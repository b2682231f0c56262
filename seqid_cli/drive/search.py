"""Gains at given delays by least squares, and the delays by search.

Given both delays the law is linear (`equations`). They are searched on a grid first,
which has no wrong minimum to fall into, then by Gauss-Newton.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.equations import (
    DERIVATIVE,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
    Delays,
    JointLaw,
)
from seqid_cli.drive.slopes import slopes_over_delays
from seqid_cli.inspect.channels.commands import FOLLOWED, lag_between
from seqid_cli.typing import Array

FEWEST_ROWS = 40  # of all logs, for a controller to be fitted
# Commands that step are looked for within so many rows of the grid's best, in steps of
# a share of a row, and then of a controller; then within so many finer steps, as long
# as one of them is likely.
HELD_ROWS = 1.5
HELD_STEP = 0.25
HELD_STEP_S = 1e-4
HELD_FINER = 4
# Times that leave up to so many times the least are looked at closely, so many of them.
HELD_ALIKE = 2.0
MOST_TOTALS = 12
BEST_TOTALS = 4
# Of what is left, by which times are not told apart: steps that come between two rows
# are alike, but for the form of the law.
ALIKE = 0.05
AT_END = 0.5  # of the likeliest, from which on times beyond an end count
MOST_MOVES = 4  # where the least is at an end of these times
FINEST_S = 2e-5
# Rounds of Gauss-Newton at most, shares of a step that are tried, and a step [s] after
# which none follows.
ROUNDS = 8
SHARES = (1.0, 0.3, 0.1)
NEAR_S = 1e-7
NEAR_LAG_S = 1e-4
# A command is looked for as late as this [s]: loops that are slower are none.
MAX_DELAY_S = 0.25
# The torque's channel is looked for as late as this [s]: filters of a drive take less.
MAX_LAG_S = 0.02
# Steps of the grid over the command's delay, and of that over the torque's lag.
GRID_S = 5e-3
LAG_GRID = 3


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Least squares at some delays."""

    delays: Delays
    theta: Array  # (p,)
    squares: float  # (N m)^2, left over
    # What delays that are as likely move gains and delays by, squared (p + 2,).
    spread: Array | float = 0.0

    def opposes(self, names: Sequence[str]) -> bool:
        """Tell whether the law drives errors back and takes energy away.

        At a wrong delay the opposite may explain a torque as well.
        """
        gains = dict(zip(names, self.theta.tolist(), strict=True))
        return bool(gains[PROPORTIONAL] > 0.0 and gains.get(DERIVATIVE, 0.0) >= 0.0)


def first_names(law: JointLaw) -> list[str]:
    """Return the parts by which delays are looked for first."""
    names = [PROPORTIONAL, DERIVATIVE]
    if law.course != "held":
        names.append(VELOCITY_FEEDFORWARD)
    return names


def solved_at(law: JointLaw, names: Sequence[str], delays: Delays) -> Solution | None:
    """Solve for the gains at some delays; None where too few rows are there."""
    equations = law.equations(names, delays)
    if len(equations.y) < FEWEST_ROWS:
        return None
    theta: Array = np.asarray(
        np.linalg.lstsq(equations.X, equations.y, rcond=1e-10)[0], np.float64
    )
    left = equations.y - equations.X @ theta
    # Delays change how many rows there are: the mean counts.
    return Solution(delays=delays, theta=theta, squares=float(np.mean(left**2)))


def search(
    law: JointLaw, names: Sequence[str], *, roughly: bool = False
) -> Solution | None:
    """Find both delays on a grid, then between its places.

    `roughly`: commands that step are found to `HELD_STEP` of a row.
    """
    # Of bends only the law of the result is free: a grid would take long for them.
    of_grid = replace(law, bends=False)
    lags = np.linspace(0.0, MAX_LAG_S, LAG_GRID)
    if not law.logs[0].measured:
        lags = lags[:1]
    lowest = -law.logs[0].command_period_s
    best: Solution | None = None
    best_opposes = False
    for lag in lags:
        for delay in np.arange(lowest, _longest_delay(law), GRID_S):
            delays = Delays(command=float(delay), torque=float(lag))
            solution = solved_at(of_grid, names, delays)
            if solution is None:
                continue
            opposes = solution.opposes(names)
            is_better = best is None or solution.squares < best.squares
            if (opposes and not best_opposes) or (
                opposes == best_opposes and is_better
            ):
                best = solution
                best_opposes = opposes
    if best is None:
        return None
    if law.course == "held":
        best = _near(of_grid, names, best)
    if roughly:
        return same_steps(law, names, best.delays)
    return refined(law, names, best.delays)


def _near(law: JointLaw, names: Sequence[str], start: Solution) -> Solution:
    """Find both delays to a part of a row, where commands step.

    At the places of a grid the lag makes up for the rest of a row.
    """
    row_s = 1.0 / law.logs[0].rate_hz
    middle = start.delays.command + start.delays.torque
    best = start
    for move in np.arange(-HELD_ROWS, HELD_ROWS + 1e-9, HELD_STEP) * row_s:
        total_s = float(middle + move)
        solution = _with_lag(law, names, total_s, start.delays.torque)
        if solution is None or not solution.squares < best.squares:
            continue
        if solution.opposes(names) or not best.opposes(names):
            best = solution
    return best


def same_steps(law: JointLaw, names: Sequence[str], start: Delays) -> Solution:
    """Find both delays; when commands that step arrive stays as it is."""
    if law.course != "held":
        return refined(law, names, start)
    solution = _with_lag(law, names, start.command + start.torque, start.torque)
    assert solution is not None
    return solution


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


def refined(law: JointLaw, names: Sequence[str], start: Delays) -> Solution:
    """Find both delays between the places of the grid."""
    if law.course == "held":
        return _refined_held(law, names, start)
    best = solved_at(law, names, start)
    assert best is not None
    for _ in range(ROUNDS):
        step = _step(law, names, best)
        other = _better(law, names, best, step)
        if other is None:
            break
        best = other
        if np.abs(step).max() < NEAR_S:
            break
    return best


def _step(law: JointLaw, names: Sequence[str], at: Solution) -> Array:
    """Return the step of Gauss-Newton in the delays (2,) [s]."""
    equations = law.equations(names, at.delays)
    slopes = slopes_over_delays(law, names, at.theta, at.delays, equations)
    J = np.hstack([equations.X, slopes])
    left = equations.y - equations.X @ at.theta
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    change = np.linalg.lstsq(J / scale, left, rcond=1e-10)[0] / scale
    step = np.zeros(2)
    step[: slopes.shape[1]] = change[len(names) :]
    return np.clip(step, -GRID_S, GRID_S)


def _better(
    law: JointLaw, names: Sequence[str], best: Solution, step: Array
) -> Solution | None:
    """Return a solution a step on, or a part of it, that leaves less; None for none."""
    opposes = best.opposes(names)
    for share in SHARES:
        delays = best.delays.moved(
            command=float(share * step[0]), torque=float(share * step[1])
        )
        if not -MAX_LAG_S <= delays.torque <= 2.0 * MAX_LAG_S:
            continue
        other = solved_at(law, names, delays)
        if other is None or (opposes and not other.opposes(names)):
            continue
        if other.squares < best.squares:
            return other
    return None


def _refined_held(law: JointLaw, names: Sequence[str], start: Delays) -> Solution:
    """Find both delays where commands step: all between two rows is one and the same.

    Every time from command to torque counts as much as it is likely. The mean of all is
    the answer, and what they differ by belongs to its error.
    """
    totals = _scanned(law, names, start)
    step_s = float(np.median(np.diff(totals))) if len(totals) > 1 else HELD_STEP_S
    moves_left = MOST_MOVES
    finer = np.arange(-HELD_FINER, HELD_FINER + 1, dtype=np.float64)
    lag = start.torque
    while True:
        solutions = []
        for total in totals:
            solution = _with_lag(law, names, float(total), lag)
            if solution is not None:
                solutions.append(solution)
                lag = solution.delays.torque
        weights = _likelihoods(law, solutions)
        likeliest = solutions[int(np.argmax(weights))]
        # Times that are not told apart share the weight: the first of them says little.
        at_end = max(weights[0], weights[-1]) > AT_END * weights.max()
        lag = likeliest.delays.torque
        unknowns = np.array([_unknowns_of(solution) for solution in solutions])
        mean = weights @ unknowns
        spread = weights @ (unknowns - mean) ** 2
        middle = float(mean[-2:].sum())
        squares = (unknowns[:, -2:].sum(axis=1) - middle) ** 2
        spread_s = float(np.sqrt(weights @ squares))
        if at_end and moves_left:
            # The least lies beyond: the lag was that of another time.
            moves_left -= 1
        elif spread_s > step_s or step_s < FINEST_S:
            break
        else:
            step_s = 0.25 * step_s
        totals = middle + step_s * finer
    delays = Delays(command=float(mean[-2]), torque=float(mean[-1]))
    best = solved_at(law, names, delays) or likeliest
    # A step of the grid is as good as any place in it.
    spread[-2] += step_s**2 / 12.0
    return replace(best, spread=spread)


def _scanned(law: JointLaw, names: Sequence[str], start: Delays) -> Array:
    """Return times from command to torque (K,) [s] that may be, the lag as it is.

    Where commands and rows come at one beat, all steps pass a row within a moment: at
    the wrong side of it they are a row off, all or some of them. Where steps are far
    from rows, all times between two rows are alike.
    """
    side_s = HELD_ROWS / law.logs[0].rate_hz
    bare = replace(law, bends=False)
    totals = []
    squares = []
    for move in np.arange(-side_s, side_s + 1e-9, HELD_STEP_S):
        delays = start.moved(command=float(move))
        solution = solved_at(bare, names, delays)
        if solution is not None:
            totals.append(delays.command + delays.torque)
            squares.append(solution.squares)
    order = np.argsort(squares)
    alike = np.flatnonzero(np.array(squares) <= HELD_ALIKE * min(squares))
    stride = max(1, len(alike) // MOST_TOTALS)
    chosen = np.union1d(alike[::stride], order[:BEST_TOTALS])
    return np.array(totals)[chosen]


def _unknowns_of(solution: Solution) -> Array:
    """Return gains and both delays (p + 2,)."""
    delays = [solution.delays.command, solution.delays.torque]
    return np.append(solution.theta, delays)


def _likelihoods(law: JointLaw, solutions: Sequence[Solution]) -> Array:
    """Return how likely each solution is, all together 1."""
    squares = np.array([solution.squares for solution in solutions])
    excess = np.maximum(squares / squares.min() - 1.0 - ALIKE, 0.0)
    weights = np.exp(-0.5 * independent_rows(law) * excess)
    return np.asarray(weights / weights.sum())


def independent_rows(law: JointLaw) -> float:
    """Return how many rows there are that do not repeat others.

    Those within half a period of the cut-off do.
    """
    rows = sum(int(np.count_nonzero(used)) for used in law.used)
    log = law.logs[0]
    return rows * min(1.0, 2.0 * log.cutoff_hz / log.rate_hz)


def _with_lag(
    law: JointLaw, names: Sequence[str], total_s: float, lag_s: float
) -> Solution | None:
    """Find the torque's lag where the time from command to torque is given."""

    def at(lag: float) -> Solution | None:
        return solved_at(law, names, Delays(command=total_s - lag, torque=lag))

    best = at(lag_s if law.logs[0].measured else 0.0)
    if best is None or not law.logs[0].measured:
        return best
    for _ in range(ROUNDS):
        step_s = float(_step(law, names, best)[1])
        for share in SHARES:
            lag = best.delays.torque + share * step_s
            other = at(float(np.clip(lag, -MAX_LAG_S, 2.0 * MAX_LAG_S)))
            if other is not None and other.squares < best.squares:
                best = other
                break
        else:
            break
        # What the next step would move is the square of this one.
        if abs(step_s) < NEAR_LAG_S:
            break
    return best
