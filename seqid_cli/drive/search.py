"""Gains at given delays by least squares, and the delays by search.

Given both delays the law is linear (`equations`). They are searched on a grid first,
which has no wrong minimum to fall into, then by the simplex.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from seqid_cli.drive.equations import (
    DERIVATIVE,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
    Delays,
    JointLaw,
)
from seqid_cli.inspect.channels.commands import FOLLOWED, lag_between
from seqid_cli.typing import Array

FEWEST_ROWS = 40  # of all logs, for a controller to be fitted
# Commands that step are looked for within so many rows of the grid's best, in steps of
# a share of a row; what leaves so little more is as good.
HELD_ROWS = 1.5
HELD_STEP = 0.25
AS_GOOD = 1e-3
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


def search(law: JointLaw, names: Sequence[str]) -> Solution | None:
    """Find both delays on a grid, then by the simplex."""
    lags = np.linspace(0.0, MAX_LAG_S, LAG_GRID)
    if not law.logs[0].measured:
        lags = lags[:1]
    lowest = -law.logs[0].command_period_s
    best: Solution | None = None
    best_opposes = False
    for lag in lags:
        for delay in np.arange(lowest, _longest_delay(law), GRID_S):
            delays = Delays(command=float(delay), torque=float(lag))
            solution = solved_at(law, names, delays)
            if solution is None:
                continue
            opposes = solution.opposes(names)
            is_better = best is None or solution.squares < best.squares
            if (opposes and not best_opposes) or (
                opposes == best_opposes and is_better
            ):
                best = solution
                best_opposes = opposes
    return None if best is None else refined(law, names, best.delays)


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
            solution = solved_at(law, names, inside)
            worst = np.inf if solution is None else solution.squares
            return float(worst * (1.0 + beyond / scale_s))
        solution = solved_at(law, names, delays)
        if solution is None or (start_opposes and not solution.opposes(names)):
            return np.inf
        return solution.squares

    first = solved_at(law, names, start)
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
    solution = solved_at(law, names, at(x))
    assert solution is not None
    return solution


def _refined_held(law: JointLaw, names: Sequence[str], start: Delays) -> Solution:
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
    return solved_at(law, names, delays) or best


def _best_lag(law: JointLaw, names: Sequence[str], total_s: float) -> Solution | None:
    """Find the torque's lag where the time from command to torque is given."""

    def at(lag: float) -> Solution | None:
        delays = Delays(command=total_s - lag, torque=lag)
        return solved_at(law, names, delays)

    if not law.logs[0].measured:
        return at(0.0)

    def squares(lag: float) -> float:
        solution = at(lag)
        return np.inf if solution is None else solution.squares

    found = minimize_scalar(
        squares, bounds=(0.0, MAX_LAG_S), method="bounded", options={"xatol": 2e-5}
    )
    return at(float(found.x))
