"""The robot's equations against the log: axes, zeros, order of joints, size of torque.

Two comparisons. The structural one needs no inertial parameters: all joints share one
set of base parameters (gravity and inertia), so a joint whose axis, zero or place is
another one spoils the fit, and mending it restores the fit. The nominal one needs a
URDF with inertials, by which the torque of a joint that carries weight has a size
(`weights`). Each cause of a misfit is the change to log or robot that undoes it.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.inspect.dynamics.angles import angle_findings, far_angle_finding
from seqid_cli.inspect.dynamics.causes import Cause, causes_of, mounted, zero_off
from seqid_cli.inspect.dynamics.friction import Sample, scaled_residual
from seqid_cli.inspect.dynamics.structure import sliding, structural_error
from seqid_cli.inspect.dynamics.weights import (
    common_factor,
    weight_findings,
    weights,
)
from seqid_cli.inspect.dynamics.zeros import zero_findings
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Robot
from seqid_cli.shares import percent

BETTER = 0.8  # of another cause's error: less of a difference decides nothing
# Ratio of errors of all equations that a zero changes, and a centre of mass not.
CLEARLY = 1.02
# How a finding of the mounting reads where one direction alone fits.
GRAVITY = re.compile(r"gravity acts along (\[[^\]]*\]);")
Measure = Callable[[Sample], float]


def geometry_findings(
    data: LogData, sample: Sample, friction: list[InspectionFinding]
) -> list[InspectionFinding]:
    """Compare a log with the robot's equations.

    Another cause that mends the equations explains what friction shows as well: a zero
    that is off leaves gravity in the torque, which may look like friction of any sign.

    Parameters
    ----------
    data : LogData
        The log.
    sample : Sample
        Its filtered motion and torque.
    friction : list of InspectionFinding
        What friction shows.

    Returns
    -------
    list of InspectionFinding
        Findings of friction, or those that explain them.
    """
    if not data.modelled or not sample.moving:
        return friction
    structural = [*_structural(data, sample)]
    if friction:
        mends = [f for f in structural if f.code != "model_mismatch"]
        agree = _places(friction) & _places(mends)
        return friction if agree or not mends else mends
    return structural or [*_scale(data, sample.thinned())]


def _places(findings: Sequence[InspectionFinding]) -> set[tuple[str, ...]]:
    """Return codes with the joints that they are about, in one order."""
    return {(f.code, *sorted(f.joint.split(", "))) for f in findings}


def _structural(
    data: LogData,
    sample: Sample,
    *,
    min_steps: int = 10,
) -> Iterator[InspectionFinding]:
    """Look for a cause where the equations leave too much of the torque.

    Far too much without a cause is a finding of its own, where joints move faster than
    `min_steps` encoder steps per second.
    """
    settings = data.settings.dynamics
    thin = sample.thinned()
    error = structural_error(thin)
    if error < settings.max_left:
        yield from [*angle_findings(thin)] or _nearly_right(thin, error)
        return
    of_angles = far_angle_finding(thin, error)
    if of_angles is not None:
        yield of_angles
        return
    causes = [*causes_of(data, thin, units=True)]
    mended = _mending(thin, error, structural_error, causes)
    if mended is not None:
        yield mended
        return
    is_fast = (sample.rms_speeds > min_steps * data.step)[list(sample.moving)].all()
    if error > settings.max_unexplained and is_fast:
        text = f"the equations leave {percent(error, 0)} of the torque's RMS"
        yield finding_of("model_mismatch", text)


def _nearly_right(
    sample: Sample, error: float, *, max_ratio: float = 0.5, max_left: float = 0.1
) -> Iterator[InspectionFinding]:
    """Find gravity turned round, or a zero off, where the equations leave little.

    Free parameters take up nearly all of such a fault, so what it leaves is small
    against the torque, but large against what the right robot leaves: `max_ratio` of
    the `error` or less. The URDF's inertials cannot take up a zero that is off: what
    they leave beyond the free parameters must fall as far, to `max_left` of the torque
    or less. A centre of mass that the URDF has wrong looks alike in the torque of that
    joint alone, not in the equations of all joints, which then decide between the two.
    """
    causes = _shifted(sample, structural_error)
    if sample.robot.gravity.any():
        causes = [mounted(-sample.robot.gravity), *causes]
    best = _best(causes, sample, structural_error)
    if best is not None and best.error <= max_ratio * error:
        yield _mended(sample.robot, [best.cause], _fall(error, best.error))
        return

    if sample.robot.nominal is None:
        yield from zero_findings(sample)
        return
    best = _best(_shifted(sample, _nominal_error), sample, _nominal_error)
    if best is None:
        return
    shifted_error = structural_error(best.cause.on(sample))
    error_before = _beyond(_nominal_error(sample), error)
    error_after = _beyond(best.error, shifted_error)
    if error_after > min(max_ratio * error_before, max_left):
        return
    fall = _fall(
        error_before,
        error_after,
        "what the URDF's inertials leave beyond free parameters",
    )
    if shifted_error < error / CLEARLY:
        yield _mended(sample.robot, [best.cause], fall)
    elif shifted_error < error * CLEARLY:
        name = sample.robot.joint_names[best.cause.joints[0]]
        text = (
            f"{best.cause.text}, or its centre of mass is not where the URDF has it;"
            f" {fall}"
        )
        yield finding_of("zero_or_mass", text, name, "position")


class _Fit(NamedTuple):
    """A cause, and the error that a sample has once it is undone."""

    error: float
    cause: Cause


def _best(causes: Sequence[Cause], sample: Sample, measure: Measure) -> _Fit | None:
    """Return the cause that leaves the least error; None where there is none."""
    fits = [_Fit(measure(cause.on(sample)), cause) for cause in causes]
    return min(fits, key=lambda fit: fit.error, default=None)


def _beyond(error: float, part: float) -> float:
    """Return what of an RMS error is beyond a part of it."""
    return float(np.sqrt(max(error**2 - part**2, 0.0)))


def _shifted(
    sample: Sample,
    measure: Measure,
    *,
    slightly: float = 0.05,
    min_gain: float = 0.03,
    few_rows: int = 250,
    angles: int = 12,
    precise: float = 1e-3,
) -> list[Cause]:
    """Shift the zero of each revolute joint to where it fits best.

    Parameters
    ----------
    sample : Sample
        Rows of the log.
    measure : callable
        Error of a sample [-], a smooth function of the angle.
    slightly : float
        Angle [rad] either way by which a joint is tried first.
    min_gain : float
        Share by which that must lower the error, else the joint is left alone.
    few_rows : int
        Rows of the first try and of the search, which costs an evaluation for each
        angle.
    angles : int
        Angles over a turn from which the search begins at the best.
    precise : float
        Angle [rad] to which the shift is found.
    """
    few = sample.thinned(few_rows)
    robot = sample.robot
    unshifted_error = measure(few)
    causes = []
    for j in sample.moving:
        if robot.joints[j].prismatic:
            continue

        def error(angle: float, j: int = j) -> float:
            return measure(zero_off(robot, j, angle).on(few))

        # A search, and its import, take long: only where a small shift already helps.
        least = min(error(slightly), error(-slightly))
        if least > (1.0 - min_gain) * unshifted_error:
            continue
        from scipy.optimize import minimize_scalar

        spacing = 2.0 * np.pi / angles
        candidates = 2.0 * np.pi * np.arange(angles) / angles
        start = float(min(candidates, key=error))
        best = minimize_scalar(
            error,
            bounds=(start - spacing, start + spacing),
            method="bounded",
            options={"xatol": precise},
        )
        angle = float((best.x + np.pi) % (2.0 * np.pi) - np.pi)
        if abs(angle) > slightly / 2.0:
            causes.append(zero_off(robot, j, angle))
    return causes


def _fall(
    error_before: float, error_after: float, quantity: str = "the equations' error"
) -> str:
    """Return in words how far a change lowers an error."""
    return f"{quantity} falls from {percent(error_before)} to {percent(error_after)}"


def _mending(
    sample: Sample,
    error_before: float,
    measure: Measure,
    causes: Sequence[Cause],
    *,
    max_ratio: float = 0.5,
    max_error: float = 0.35,
    max_rivals: int = 8,
    max_alike: int = 3,
    few_rows: int = 250,
) -> InspectionFinding | None:
    """Find the change that mends a fit; None where none does, or too many do.

    One of the causes, gravity along an axis of the base, or in any direction: of these
    kinds the first counts, unless a later one leaves clearly less. Where several of a
    kind do as well, the inertials of a URDF decide: gravity turned round fits as well
    with parameters of the other sign.

    Parameters
    ----------
    sample : Sample
        Rows of the log.
    error_before : float
        Its error as it is [-].
    measure : callable
        Error of a sample [-].
    causes : sequence of Cause
        Faults that it may have.
    max_ratio : float
        Share of the error before that a cause leaves at most.
    max_error : float
        Error that a cause leaves at most.
    max_rivals : int
        Causes that are compared on all rows.
    max_alike : int
        Sets of joints at which causes may do as well.
    few_rows : int
        Rows on which all causes are tried.
    """
    few = sample.thinned(few_rows)
    likeliest = sorted(causes, key=lambda cause: measure(cause.on(few)))
    kinds = [likeliest[:max_rivals]]
    strength = float(np.linalg.norm(sample.robot.gravity))
    if strength:
        directions = strength * np.vstack([np.eye(3), -np.eye(3)])
        axes = [mounted(gravity) for gravity in directions]
        kinds.append(axes)
        kinds.append(_slanted(few, axes, measure))

    chosen: list[Cause] = []
    least = np.inf
    for kind in kinds:
        fits = [_Fit(measure(cause.on(sample)), cause) for cause in kind]
        limit = min(max_ratio * error_before, max_error)
        mends = [fit for fit in fits if fit.error <= limit]
        best = min((fit.error for fit in mends), default=np.inf)
        as_good = [fit.cause for fit in mends if fit.error < best / BETTER]
        places = {frozenset(cause.joints) for cause in as_good}
        if best < BETTER * least and len(places) <= max_alike:
            chosen = as_good
            least = best
    if not chosen:
        return None
    if sample.robot.nominal is not None:
        chosen.sort(key=lambda cause: _nominal_error(cause.on(sample)))
    return _mended(sample.robot, chosen, _fall(error_before, least))


def _mended(robot: Robot, causes: Sequence[Cause], fall: str) -> InspectionFinding:
    """Return the finding of causes that mend a fit alike, the first of them first."""
    cause = causes[0]
    if not cause.joints:
        # Without inertials of a URDF gravity may as well act the other way.
        count = 2 if robot.nominal is None else 1
        along = " or ".join(each.text for each in causes[:count])
        return finding_of(cause.code, f"gravity acts along {along}; {fall}")

    text = f"{cause.text}; {fall}"
    others = [
        f"{_joints_in_words(robot, each)}: {each.text}"
        for each in causes
        if set(each.joints) != set(cause.joints)
    ]
    if others:
        text += f" (as well with {'; or '.join(others)})"
    return finding_of(cause.code, text, _joints_in_words(robot, cause), cause.channel)


def _joints_in_words(robot: Robot, cause: Cause) -> str:
    """Return the names of a cause's joints."""
    return ", ".join(robot.joint_names[j] for j in cause.joints)


def _slanted(
    sample: Sample,
    axes: Sequence[Cause],
    measure: Measure,
    *,
    reach: float = 0.5,
    precise: float = 2e-3,
    evaluations: int = 60,
) -> list[Cause]:
    """Return gravity in the direction that fits best, and against it.

    The search begins at the best of the `axes`, `reach` [rad] to two sides, and ends at
    `precise` [rad] or after so many `evaluations`.
    """
    from scipy.optimize import minimize

    start = min(axes, key=lambda axis: measure(axis.on(sample))).gravity
    assert start is not None
    strength = np.linalg.norm(start)
    across = np.linalg.svd(start[None])[2][1:]  # two directions across it

    def gravity(x: Array) -> Array:
        turned = start + strength * (x @ across)
        return np.asarray(turned * strength / np.linalg.norm(turned))

    def error(x: Array) -> float:
        return measure(mounted(gravity(x)).on(sample))

    simplex = reach * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {
        "initial_simplex": simplex,
        "xatol": precise,
        "fatol": np.inf,
        "maxfev": evaluations,
    }
    search = minimize(
        error,
        np.zeros(2),
        method="Nelder-Mead",
        options=options,  # type: ignore[call-overload]
    )
    best = gravity(search.x)
    return [mounted(best), mounted(-best)]


def _scale(data: LogData, sample: Sample) -> Iterator[InspectionFinding]:
    """Judge the size of the torque at the joints that carry weight."""
    found = [*weights(sample)]
    of_size = [*weight_findings(data, found)]
    is_wrong = any(finding.severity == "error" for finding in of_size)
    if is_wrong and common_factor(found) is None:
        causes = [*causes_of(data, sample)]
        mended = _mending(sample, _nominal_error(sample), _nominal_error, causes)
        if mended:
            yield mended
            return
    yield from of_size


def _nominal_error(sample: Sample) -> float:
    """Return the RMS that URDF and friction leave, in shares of torques' spreads."""
    gravity_and_inertia = np.sum(sample.nominal(), axis=0)
    difference = sample.tau - gravity_and_inertia
    friction = sample.friction_columns()
    slides = sliding(sample)
    shares = []
    for j in sample.moving:
        rows = slides[:, j]
        if not rows.any():
            continue
        residual = scaled_residual(friction[rows, j], difference[rows, j])
        variance = max(float(sample.tau[rows, j].var()), 1e-300)
        shares.append(np.mean(residual**2) / variance)
    return float(np.sqrt(np.mean(shares))) if shares else 0.0
