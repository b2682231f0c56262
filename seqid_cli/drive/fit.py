"""The controller of one joint by least squares over rows, its delays by search.

Parts that the logs cannot show are left out before; parts that are not there are taken
out one by one. Rows near a limit of the torque are left out (`limits`).

What the choice of the band does is no noise at all. The fit is made once more with half
of the cut-off, and the change counts beside the errors of noise (`row_errors`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.courses import Candidate, better_course, tells_course
from seqid_cli.drive.equations import (
    ACCELERATION_FEEDFORWARD,
    DERIVATIVE,
    GRAVITY,
    INTEGRAL,
    PARTS,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
    Delays,
    JointLaw,
    own_shares,
    telling_rows,
)
from seqid_cli.drive.limits import (
    NEAR_LIMIT,
    TOP_SHARE,
    Limit,
    below,
    speed_limit_of,
    torque_limit_of,
)
from seqid_cli.drive.row_errors import row_errors
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.drive.search import (
    Solution,
    first_names,
    independent_rows,
    refined,
    same_steps,
    search,
)
from seqid_cli.drive.settings import DriveSettings, TermSettings
from seqid_cli.drive.signals import DriveSignals, courses_of_all

FEEDFORWARD = (VELOCITY_FEEDFORWARD, ACCELERATION_FEEDFORWARD)
# Share of a part's column that no other explains: with less, logs cannot show the part.
MIN_OWN_SHARE = 0.005
# Share of what is left that a part takes away at least: less is the form of the law.
MIN_GAIN = 0.005
# Standard errors by which half of the band moves a number by chance.
BAND_SIGMA = 3.0


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
    begun = []
    courses = courses_of_all(logs)
    if not tells_course(logs):
        courses = courses[:1]
    for course in courses:
        beginning = _begun(logs, joint, course)
        if beginning is not None:
            begun.append(beginning)
    if not begun:
        return None
    chosen = 0
    is_known = len(courses_of_all(logs)) < 2
    if len(begun) > 1:
        candidates = [
            Candidate(course=each.law.course, delays=each.first.delays)
            for each in begun
        ]
        better = better_course(logs, joint, candidates)
        is_known = better is not None
        chosen = better or 0
    beginning = begun[chosen]
    fit = _finished(beginning, narrow, settings)
    if beginning.limit is not None and fit is not None and fit.limit is None:
        # The whole law asks for no more than there was: no row is at a limit.
        whole = _begun(logs, joint, beginning.law.course, limits=False)
        fit = fit if whole is None else _finished(whole, narrow, settings)
    return None if fit is None else replace(fit, course_is_known=is_known)


@dataclass(frozen=True, kw_only=True)
class _Beginning:
    """A joint's law before its parts are told apart.

    `first` is by the parts of `search.first_names`, `largest` the largest torque [N m].
    """

    law: JointLaw
    first: Solution
    limit: Limit | None
    largest: float


def _begun(
    logs: Sequence[DriveSignals], joint: int, course: str, *, limits: bool = True
) -> _Beginning | None:
    """Look for delays, and for limits, given what commands do between two stamps."""
    law = JointLaw(
        logs=logs,
        joint=joint,
        course=course,
        used=[telling_rows(log, joint) for log in logs],
        lawful=[log.usable[:, joint] for log in logs],
    )
    largest = max(
        float(np.abs(log.torque[used, joint]).max(initial=0.0))
        for log, used in zip(logs, law.used, strict=True)
    )
    if not largest > 0.0:
        return None

    without_top = replace(law, used=below(law, law.used, TOP_SHARE * largest))
    first = search(without_top, first_names(law), roughly=True)
    if first is None:
        first = search(law, first_names(law), roughly=True)
    if first is None:
        return None
    limit = None
    if limits:
        limit = torque_limit_of(law, first_names(law), first, largest)
    if limit is not None:
        law = replace(
            law,
            used=below(law, law.used, NEAR_LIMIT * limit.value),
            lawful=below(law, law.lawful, NEAR_LIMIT * limit.value),
        )
        again = search(law, first_names(law), roughly=True)
        first = first if again is None else again
    return _Beginning(law=law, first=first, limit=limit, largest=largest)


def _finished(
    beginning: _Beginning, narrow: Sequence[DriveSignals], settings: DriveSettings
) -> JointFit | None:
    """Find which parts the law has, and describe it."""
    law = beginning.law
    shares, shown = _shown(law, beginning.first.delays)
    # Another law may have another delay: the whole grid once more.
    solution = search(law, shown, roughly=True)
    if solution is None:
        return None
    names, solution, refused = _without_absent(law, shown, solution, settings)
    limit = beginning.limit
    if limit is not None:
        # The first law lacks parts, an integral above all, and may ask for too much.
        of_all = replace(law, used=[telling_rows(log, law.joint) for log in law.logs])
        if torque_limit_of(of_all, names, solution, beginning.largest) is None:
            limit = None
    return _described(
        law,
        narrow,
        names,
        solution,
        refused,
        shares,
        limit,
        beginning.largest,
    )


def _shown(law: JointLaw, delays: Delays) -> tuple[dict[str, float], list[str]]:
    """Return the shares of parts' columns that are their own, and parts that show.

    No controller is without a proportional part: where other parts explain its column,
    the one with the least of its own is left out.
    """
    names = _possible(law)
    shares = _shares(law, names, delays)
    while shares[PROPORTIONAL] < MIN_OWN_SHARE and len(names) > 1:
        others = [name for name in names if name != PROPORTIONAL]
        least = min(others, key=lambda name: shares[name])
        names.remove(least)
        shares |= _shares(law, names, delays)
    shown = [name for name in (*names, INTEGRAL) if shares[name] >= MIN_OWN_SHARE]
    return shares, shown or [PROPORTIONAL]


def _possible(law: JointLaw) -> list[str]:
    """Return the parts beside an integral that these logs may show."""
    names = [name for name in PARTS if name != INTEGRAL]
    if law.course == "held":
        # A command that steps has no slope for a controller to feed forward.
        names = [name for name in names if name not in FEEDFORWARD]
    elif not law.logs[0].measured:
        # The model's torque is mostly the acceleration, and so is that of a command
        # which the joint follows: this part would stand for the whole controller.
        names.remove(ACCELERATION_FEEDFORWARD)
    return names


def _shares(law: JointLaw, names: Sequence[str], delays: Delays) -> dict[str, float]:
    """Return the share of each part's column that the other parts do not explain."""
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
    solution: Solution,
    settings: DriveSettings,
) -> tuple[tuple[str, ...], Solution, dict[str, float]]:
    """Take parts out one by one that are not there; returns their standard errors.

    These hold what a part seemed to be as well.
    """
    names = list(shown)
    refused: dict[str, float] = {}
    while len(names) > 1:
        errors = row_errors(law, names, solution)
        sigma = np.abs(solution.theta) / np.maximum(errors[: len(names)], 1e-300)
        order = [k for k in np.argsort(sigma) if names[k] != PROPORTIONAL]
        weakest = int(order[0])
        fewer = [name for k, name in enumerate(names) if k != weakest]
        # The integral changes which rows share an offset: both on the same ones.
        simpler = same_steps(law, fewer, solution.delays)
        gain = 1.0 - solution.squares / max(simpler.squares, 1e-300)
        by_gain = float(np.sqrt(max(gain, 0.0) * independent_rows(law)))
        if is_part(min(float(sigma[weakest]), by_gain), gain, settings.terms):
            break
        # It may be as large as it seemed: no log tells it from the form of the law.
        seeming = float(solution.theta[weakest])
        refused[names[weakest]] = float(np.hypot(errors[weakest], seeming))
        names = fewer
        solution = simpler
    return tuple(names), refined(law, names, solution.delays), refused


def is_part(sigma: float, gain: float, settings: TermSettings) -> bool:
    """Tell whether a part is there.

    Parameters
    ----------
    sigma : float
        Standard errors from zero: of its number, or of what it takes away where these
        are fewer. A delay and both feed-forwards are nearly one, so that the errors of
        linear equations say too little there.
    gain : float
        Share of what is left that it takes away.
    settings : TermSettings
    """
    return sigma >= settings.min_sigma and gain >= MIN_GAIN


def _described(
    law: JointLaw,
    narrow: Sequence[DriveSignals],
    names: tuple[str, ...],
    solution: Solution,
    refused: dict[str, float],
    shares: dict[str, float],
    limit: Limit | None,
    largest: float,
) -> JointFit:
    """Return the result of a fit, errors widened by what the band does."""
    equations = law.equations(names, solution.delays)
    errors = row_errors(law, names, solution)
    # The same law in half of the band, at delays of its own. When steps come is no
    # question of the band.
    in_half = replace(law, logs=narrow)
    other = same_steps(in_half, names, solution.delays)
    change = np.append(
        other.theta - solution.theta,
        [
            other.delays.command - solution.delays.command,
            other.delays.torque - solution.delays.torque,
        ],
    )
    # A change that noise makes as well is none that the band makes.
    by_noise = BAND_SIGMA * row_errors(in_half, names, other)
    errors = np.sqrt(errors**2 + np.maximum(change**2 - by_noise**2, 0.0))

    keys = [*names, "command_delay", "torque_lag"]
    values = np.append(
        solution.theta, [solution.delays.command, solution.delays.torque]
    )
    std_errors = dict(zip(keys, errors.tolist(), strict=True))
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
        speed_limit=speed_limit_of(law, solution.delays, max(speeds)),
        largest_torque=largest,
        largest_speed=max(speeds),
    )
