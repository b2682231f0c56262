"""Which parts a controller has where nothing is known of it, and where numbers begin.

Without a measured torque, and with links alone for a model, the law of a row is

    M q'' + h = kp (c - q) - kd q' + kv c' + ki S + kg g + b - J q'' - fc sign q',

with the joint's part of M q'' + h by the links, J the rotor and fc Coulomb friction.
Given the delay it is linear, so that least squares over rows find a start without a
wrong minimum to fall into, in a moment for each set of parts. Where the controller may
compensate gravity, J has to be given: with kg = 1 and a J that takes away what the
links have, all else would be zero.

Windows of the simulated joint are searched from there, for every set of parts by which
rows leave about as little, and windows that were held out choose.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.equations import (
    ARMATURE,
    COULOMB,
    DERIVATIVE,
    GRAVITY,
    INTEGRAL,
    PARTS,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
    Delays,
    JointLaw,
    telling_rows,
)
from seqid_cli.drive.rollouts.course import JointCourse
from seqid_cli.drive.rollouts.solver import Solved, solved
from seqid_cli.drive.rollouts.terms import Parts, gains
from seqid_cli.drive.rollouts.unknowns import Unknown, Unknowns
from seqid_cli.drive.search import search, solved_at
from seqid_cli.typing import Array

GRAVITY_STD = 0.5  # of a share of gravity that a controller adds
# Integral gain per second as a share of the proportional one.
USUAL_INTEGRAL_HZ = 1.0
# Standard deviations of logarithms where nothing is known.
OPEN_STD = 1.0
# Standard deviations of the prior, from which on a number is none that can be.
PLAUSIBLE = 3.5
# Parts by which rows leave so many times the least are not simulated.
LEFT_BY_ROWS = 3.0
# Of windows that are fitted, on which sets of parts are compared.
FEW_WINDOWS = 48
# Of where a search begins otherwise, the least that rows may say: what has to be
# positive may come out below zero.
LEAST_START = 0.01
# Rotors that are tried, of the usual one. One has to leave clearly less than another:
# alone, a joint whose gravity may be compensated shows none.
ROTORS = (0.25, 0.5, 2.0, 4.0, 8.0)
CLEARLY = 0.98
# Sets of parts beside gain and damping, the fewest first.
ADDED: Sequence[Sequence[str]] = (
    (),
    (INTEGRAL,),
    (VELOCITY_FEEDFORWARD,),
    (GRAVITY,),
    (VELOCITY_FEEDFORWARD, INTEGRAL),
    (GRAVITY, INTEGRAL),
    (VELOCITY_FEEDFORWARD, GRAVITY),
    (VELOCITY_FEEDFORWARD, GRAVITY, INTEGRAL),
)


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Parts of a controller, with their numbers by windows.

    Attributes
    ----------
    unknowns : Unknowns
    solution : Solved
    judged : (W,) array
        rad^2, mean squares of the held-out windows.
    """

    unknowns: Unknowns
    solution: Solved
    judged: Array

    @property
    def is_plausible(self) -> bool:
        """True where all numbers are such as they can be."""
        far = distance(self.unknowns, self.solution.theta).max()
        return bool(far < PLAUSIBLE)

    def is_better(self, other: "Structure") -> bool:
        """Tell whether held-out windows gain, by numbers that can be.

        Gravity that a controller compensates shows no scale. Without that part a search
        makes the joint as heavy as it takes to hide gravity. An integral that is all
        but zero is no integral, but another offset of each log.
        """
        if self.is_plausible and not other.is_plausible:
            return not gains(self.judged, other.judged)
        if other.is_plausible and not self.is_plausible:
            return False
        return gains(other.judged, self.judged)


def distance(unknowns: Unknowns, theta: Array) -> Array:
    """Return how far numbers (p,) are from their prior, in standard deviations."""
    return np.asarray(np.abs(theta - unknowns.mean) / unknowns.std)


def best_structure(parts: Parts, unknowns: Unknowns) -> Structure | None:
    """Find the parts of a controller; None where rows say nothing of any.

    Parameters
    ----------
    parts : Parts
        The windows.
    unknowns : Unknowns
        What every controller has.
    """
    choice: Structure | None = None
    for structure in _structures(parts, unknowns):
        if choice is None or structure.is_better(choice):
            choice = structure
    return choice


def _structures(parts: Parts, unknowns: Unknowns) -> Iterator[Structure]:
    """Yield the sets of parts that explain rows about as well as any."""
    course = parts.fitted[0].course
    few = parts.fewer(FEW_WINDOWS)
    starts = [_start_by_rows(course, _wider(unknowns, added)) for added in ADDED]
    known_starts = [start for start in starts if start is not None]
    least = min((start.unexplained for start in known_starts), default=0.0)
    for start in known_starts:
        if start.unexplained > LEFT_BY_ROWS * least:
            continue
        solution = solved(few.fitted, start.unknowns, start.theta)
        yield Structure(
            unknowns=start.unknowns,
            solution=solution,
            judged=parts.judged_freely(start.unknowns, solution.theta),
        )


def _wider(unknowns: Unknowns, added: Sequence[str]) -> Unknowns:
    """Return what is searched with some parts more."""
    by_name = {unknown.name: unknown for unknown in unknowns.searched}
    gain = by_name[PROPORTIONAL]
    candidates = {
        VELOCITY_FEEDFORWARD: replace(by_name[DERIVATIVE], name=VELOCITY_FEEDFORWARD),
        GRAVITY: Unknown(name=GRAVITY, start=1.0, std=GRAVITY_STD, positive=False),
        INTEGRAL: Unknown(
            name=INTEGRAL, start=USUAL_INTEGRAL_HZ * gain.start, std=OPEN_STD
        ),
    }
    return unknowns.with_more([candidates[name] for name in added])


@dataclass(frozen=True, kw_only=True)
class _Start:
    """Numbers by rows.

    Attributes
    ----------
    unknowns : Unknowns
    theta : (p,) array
        As it is searched.
    unexplained : float
        What rows leave, as a share of what the gain asks for.
    """

    unknowns: Unknowns
    theta: Array
    unexplained: float


def _start_by_rows(course: JointCourse, unknowns: Unknowns) -> _Start | None:
    """Find numbers by rows; None where there are too few."""
    by_name = {unknown.name: unknown for unknown in unknowns.searched}
    names = [name for name in by_name if name in (*PARTS, ARMATURE, COULOMB)]
    law = JointLaw(
        logs=course.logs,
        joint=course.joint,
        course=course.course,
        used=[telling_rows(log, course.joint) for log in course.logs],
        lawful=[log.usable[:, course.joint] for log in course.logs],
    )
    if GRAVITY in names and ARMATURE in names:
        names.remove(ARMATURE)
        by_rows = _with_rotor(law, names, by_name[ARMATURE].start)
    else:
        by_rows = _by_rows(law, names)
    if by_rows is None:
        return None

    theta = unknowns.mean
    for k, unknown in enumerate(unknowns.searched):
        value = by_rows.values.get(unknown.name, unknown.start)
        if unknown.positive:
            value = np.log(max(value, LEAST_START * unknown.start))
        theta[k] = value
    return _Start(unknowns=unknowns, theta=theta, unexplained=by_rows.unexplained)


@dataclass(frozen=True, kw_only=True)
class _Rows:
    """What rows tell: numbers by name, delays, and what is left.

    `unexplained` is a share of what the gain asks for by the error, which knows no
    scale.
    """

    values: Mapping[str, float]
    delays: Delays
    unexplained: float


def _by_rows(
    law: JointLaw, names: Sequence[str], at: Delays | None = None
) -> _Rows | None:
    """Solve for numbers by rows, at some delays or at the best ones."""
    if at is None:
        solution = search(law, names, roughly=True)
    else:
        solution = solved_at(law, names, at)
    if solution is None:
        return None
    equations = law.equations(names, solution.delays)
    values = dict(zip(names, solution.theta.tolist(), strict=True))
    values["command_delay"] = solution.delays.command
    if INTEGRAL not in names:
        mean = float(equations.means[:-1] @ solution.theta)
        values["offset"] = float(equations.means[-1]) - mean
    of_gain = values[PROPORTIONAL] * equations.X[:, names.index(PROPORTIONAL)]
    share = solution.squares / max(np.mean(of_gain**2), 1e-300)
    return _Rows(
        values=values, delays=solution.delays, unexplained=float(np.sqrt(share))
    )


def _with_rotor(law: JointLaw, names: Sequence[str], usual: float) -> _Rows | None:
    """Return numbers by rows with the rotor by which these leave least.

    Each rotor is a torque that the links do not have. What other joints ask of this one
    tells which of them is right.
    """
    best = _by_rows(_added_rotor(law, usual), names)
    if best is None:
        return None
    best_rotor = usual
    for times in ROTORS:
        rotor = times * usual
        by_rows = _by_rows(_added_rotor(law, rotor), names, best.delays)
        if by_rows is None:
            continue
        if by_rows.unexplained < CLEARLY * best.unexplained:
            best = by_rows
            best_rotor = rotor
    return replace(best, values={**best.values, ARMATURE: best_rotor})


def _added_rotor(law: JointLaw, rotor: float) -> JointLaw:
    """Return the law of a joint with a rotor [kg m^2] of its own."""
    logs = [replace(log, torque=log.torque + rotor * log.ddq) for log in law.logs]
    return replace(law, logs=logs)
