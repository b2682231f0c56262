"""Terms that a joint may need beside gains, delay and Coulomb friction, one at a time.

Every fourth window is held out. A term is kept where those windows gain by it: their
mean square falls by a share that matters and by more than it scatters. What a window
counts is bounded, so that a touch does not decide.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from seqid_cli.drive.rollouts.loop import JointLoop
from seqid_cli.drive.rollouts.solver import (
    USUAL,
    Solved,
    errors_of,
    freed,
    mean_squares,
    solved,
    start_slopes,
)
from seqid_cli.drive.rollouts.unknowns import Unknown, Unknowns
from seqid_cli.logs.raw import Rows
from seqid_cli.typing import Array

STRIBECK = "stribeck"
LOAD = "load_friction"
DEAD_BAND = "dead_band"
HELD_OUT = 4  # every so many windows one
# Delays that are tried for the guess [s].
LONGEST_GUESS_S = 0.3
GUESS_STEP_S = 0.01
# The logarithm of what is as good as nothing.
NOTHING = -30.0
# Of the mean square of held-out windows, the share by which a term lessens it at least.
LEAST_GAIN = 0.02
# Times its standard error over the windows.
GAIN_SIGMA = 1.64


def optional_terms(coulomb: float) -> Mapping[str, Sequence[Unknown]]:
    """Return what may be added, by name.

    Parameters
    ----------
    coulomb : float
        N m, the joint's Coulomb friction: where a search begins.
    """
    return {
        STRIBECK: [
            Unknown(name=STRIBECK, start=0.3 * coulomb, std=1.0),
            Unknown(name="stribeck_speed", start=0.05, std=1.0),
        ],
        LOAD: [Unknown(name=LOAD, start=0.1, std=1.0)],
        DEAD_BAND: [Unknown(name=DEAD_BAND, start=4e-3, std=1.0)],
    }


@dataclass(frozen=True, kw_only=True)
class Parts:
    """The windows of a joint: those that are fitted, and those that judge."""

    fitted: Sequence[JointLoop]
    held_out: Sequence[JointLoop]

    @classmethod
    def of(cls, loops: Sequence[JointLoop]) -> "Parts":
        """Hold every fourth window out."""
        fitted = []
        held_out = []
        for loop in loops:
            numbers = np.arange(loop.course.windows)
            judges = numbers % HELD_OUT == HELD_OUT - 1
            fitted.append(_some(loop, numbers[~judges]))
            if judges.any():
                held_out.append(_some(loop, numbers[judges]))
        return cls(fitted=fitted, held_out=held_out)

    def rough(self) -> "Parts":
        """Return the same windows in longer steps: a search takes many of them."""
        fitted, held_out = (
            [replace(loop, course=loop.course.rough()) for loop in loops]
            for loops in (self.fitted, self.held_out)
        )
        return Parts(fitted=fitted, held_out=held_out)

    def fewer(self, most: int) -> "Parts":
        """Return so many of the windows that are fitted at most, evenly."""
        total = sum(loop.course.windows for loop in self.fitted)
        stride = max(1, round(total / most))
        fitted = [
            _some(loop, np.arange(0, loop.course.windows, stride))
            for loop in self.fitted
        ]
        return replace(self, fitted=fitted)

    def judged(self, unknowns: Unknowns, theta: Array) -> Array:
        """Return mean squares (W,) [rad^2] of the held-out windows."""
        return np.asarray(mean_squares(self._off(unknowns, theta))[0])

    def judged_freely(self, unknowns: Unknowns, theta: Array) -> Array:
        """Return the same where held-out windows may begin elsewhere than the log."""
        starts = start_slopes(self.held_out, unknowns, theta)
        return np.asarray(mean_squares(freed(self._off(unknowns, theta), starts))[0])

    def _off(self, unknowns: Unknowns, theta: Array) -> list[Array]:
        return errors_of(self.held_out, unknowns, theta[None])


def _some(loop: JointLoop, numbers: Rows) -> JointLoop:
    return replace(loop, course=loop.course.of(numbers))


def bounded_rms(squares: Array) -> float:
    """Return the RMS of windows of mean squares (W,), of which none counts too much."""
    limit = USUAL**2 * float(np.median(squares))
    return float(np.sqrt(np.mean(np.minimum(squares, limit))))


def guess_rms(loops: Sequence[JointLoop]) -> float:
    """Return the RMS [rad] of a guess that needs no model, at the delay it likes best.

    It is the first position and the change of the delayed command since then.
    """
    results = []
    for delay_s in np.arange(0.0, LONGEST_GUESS_S, GUESS_STEP_S):
        squares = []
        for loop in loops:
            course = loop.course
            command = course.command(float(delay_s))[:: course.per_row]
            guess = course.q0 + command - command[0]
            squares.append(np.mean((guess - course.q[: len(guess)]) ** 2, axis=0))
        results.append(bounded_rms(np.concatenate(squares)))
    return min(results)


def gains(before: Array, after: Array) -> bool:
    """Tell whether held-out windows (W,) [rad^2] are better off than before.

    What counts is the logarithm of the factor by which their mean falls, beside what
    leaving out one window after the other changes of it. Where one of few windows was
    off most, the difference of both means would scatter as much as it is.
    """
    n = len(before)
    if n < 2:
        return False
    limit = USUAL**2 * float(np.median(before)) + 1e-300
    bounded_before = np.minimum(before, limit)
    bounded_after = np.minimum(after, limit) + 1e-12 * limit
    gain = float(np.log(bounded_before.mean() / bounded_after.mean()))

    sums_before = bounded_before.sum() - bounded_before
    sums_after = bounded_after.sum() - bounded_after
    without_each = np.log(sums_before / sums_after)
    deviation = without_each - without_each.mean()
    scatter = float(np.sqrt((n - 1) * np.mean(deviation**2)))
    # Few windows do not tell surely how much they scatter.
    sigma = float(student.ppf(norm.cdf(GAIN_SIGMA), n - 1))
    return gain > max(sigma * scatter, LEAST_GAIN)


def promised_gains(
    loops: Sequence[JointLoop],
    unknowns: Unknowns,
    base: Solved,
    terms: Mapping[str, Sequence[Unknown]],
) -> Mapping[str, float]:
    """Return the share of the mean square that each term takes away to first order.

    What a term at its start does to positions, freed of what the other numbers can do
    as well, is compared with what is left over. All terms are simulated at once.
    """
    first = {name: more[0] for name, more in terms.items()}
    wider = unknowns.with_more(list(first.values()))
    fixed = {each.name: each.start for more in terms.values() for each in more[1:]}
    wider = replace(wider, fixed={**wider.fixed, **fixed})
    off = len(base.theta)
    sets = np.tile(np.append(base.theta, [NOTHING] * len(first)), (len(first) + 1, 1))
    for k, each in enumerate(first.values()):
        sets[k, off + k] = each.mean
    simulated = freed(errors_of(loops, wider, sets), base.starts)
    root = np.sqrt(base.weights)
    left = _flat(base.errors, root)
    columns = np.stack(
        [_flat([each[p] for each in base.jacobian], root) for p in range(off)], axis=1
    )
    gains_of = {}
    for k, name in enumerate(first):
        change = _flat([each[k] - each[-1] for each in simulated], root)
        before = left - columns @ np.linalg.lstsq(columns, left, rcond=1e-10)[0]
        own = change - columns @ np.linalg.lstsq(columns, change, rcond=1e-10)[0]
        taken = float(own @ before) ** 2 / max(float(own @ own), 1e-300)
        gains_of[name] = taken / max(float(left @ left), 1e-300)
    return gains_of


def _flat(errors: Sequence[Array], root: Array) -> Array:
    """Return errors (R, W) of each rate as one column, windows by their weights."""
    first = 0
    parts = []
    for each in errors:
        count = each.shape[-1]
        parts.append((each * root[first : first + count]).ravel())
        first += count
    return np.concatenate(parts)


def with_terms(
    parts: Parts, unknowns: Unknowns, base: Solved, coulomb: float
) -> tuple[Unknowns, Solved, list[str]]:
    """Add the terms by which held-out windows gain, the best one first.

    Returns
    -------
    Unknowns, Solved
        With the terms that are kept, solved on the windows that are fitted.
    list of str
        Names of the terms.
    """
    left = dict(optional_terms(coulomb))
    kept: list[str] = []
    judged = parts.judged_freely(unknowns, base.theta)
    while left:
        tried = {}
        promised = promised_gains(parts.fitted, unknowns, base, left)
        for name, more in left.items():
            if promised[name] < LEAST_GAIN:
                continue
            wider = unknowns.with_more(more)
            start = np.append(base.theta, [each.mean for each in more])
            solution = solved(parts.fitted, wider, start)
            after = parts.judged_freely(wider, solution.theta)
            if gains(judged, after):
                tried[name] = (wider, solution, after)
        if not tried:
            break
        limit = USUAL**2 * float(np.median(judged))
        left_over = {
            name: float(np.minimum(after, limit).mean())
            for name, (_, _, after) in tried.items()
        }
        best = min(left_over, key=lambda name: left_over[name])
        unknowns, base, judged = tried[best]
        kept.append(best)
        # What gained nothing now is not tried again: terms share what they explain.
        left = {name: left[name] for name in tried if name != best}
    return unknowns, base, kept
