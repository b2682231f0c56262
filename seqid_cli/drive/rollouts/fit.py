"""The controller of one joint by whole windows, from where the fit by rows has come to.

Windows begin with the state of the log. What rows cannot show counts there: friction at
rest, an inertia that the model lacks, terms of `terms`. The fit by rows gives start and
prior. Where it says little (no torque, a model without friction) `structures` finds the
parts of the controller as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.equations import (
    DERIVATIVE,
    GRAVITY,
    INTEGRAL,
    PROPORTIONAL,
    VELOCITY_FEEDFORWARD,
)
from seqid_cli.drive.rollouts.course import JointCourse
from seqid_cli.drive.rollouts.errors import bias_of_steps, of_the_prior, std_errors
from seqid_cli.drive.rollouts.loop import NAMES, JointLoop
from seqid_cli.drive.rollouts.solver import Solved, solved
from seqid_cli.drive.rollouts.structures import (
    OPEN_STD,
    PLAUSIBLE,
    best_structure,
    distance,
)
from seqid_cli.drive.rollouts.terms import (
    Parts,
    bounded_rms,
    gains,
    guess_rms,
    with_terms,
)
from seqid_cli.drive.rollouts.unknowns import Unknown, Unknowns
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.typing import Array

FEWEST_WINDOWS = 8
# Where nothing is known: the loop's bandwidth [Hz], damping, and friction as a share of
# the torque that the usual error of the position asks for.
USUAL_HZ = 3.0
USUAL_DAMPING = 0.7
USUAL_FRICTION = 0.3
# Viscous friction as a share of the controller's damping.
USUAL_VISCOUS = 0.1
# Standard deviation of logarithms at least, without a torque.
LEAST_STD = 0.3
# Of the model's friction on another day.
FRICTION_STD = 0.2
# Of the delay, by the fit by rows without a torque [s], and where nothing is known.
LEAST_DELAY_STD_S = 5e-3
OPEN_DELAY_S = 0.03
DELAY_STEP_S = 1e-3  # by which derivatives are taken
OFFSET_STEP = 1e-6  # N m


@dataclass(frozen=True, kw_only=True)
class WindowFit:
    """The numbers of a joint by windows.

    Attributes
    ----------
    values, std_errors : dict of str to float
        Of `loop.LoopValues`, of what was searched.
    open : tuple of str
        What is the prior's and not the data's.
    terms : tuple of str
        Optional terms that were kept.
    rms : float
        rad, of windows that were held out; see `terms.bounded_rms`.
    rms_by_rows : float
        rad, of the same windows by the fit by rows; infinite where it had none.
    rms_of_guess : float
        rad, of the same windows: first position and change of the delayed command.
    windows : int
    solution : Solved
        While windows were held out.
    """

    values: dict[str, float]
    std_errors: dict[str, float]
    open: tuple[str, ...]
    terms: tuple[str, ...]
    rms: float
    rms_by_rows: float
    rms_of_guess: float
    windows: int
    solution: Solved
    unknowns: Unknowns
    parts: Parts
    by_rows: JointFit | None


def given_errors(unknowns: Unknowns, by_rows: JointFit) -> dict[str, float]:
    """Return the standard errors of what rows have told and windows do not search."""
    return {
        name: by_rows.std_errors[name]
        for name in unknowns.fixed
        if by_rows.std_errors.get(name, 0.0) > 0.0
    }


def fit_windows(
    loops: Sequence[JointLoop],
    smooth: Sequence[JointLoop],
    by_rows: JointFit | None,
    *,
    measured: bool,
    nominal: bool,
) -> WindowFit | None:
    """Fit a joint by windows; None where too few are there.

    Parameters
    ----------
    loops, smooth : sequence of JointLoop
        The windows, and the same with the arm's motion in half of its band.
    by_rows : JointFit, optional
        None where it explains too little to begin with.
    measured : bool
        Whether it explained a measured torque: its gains then stay as they are.
    nominal : bool
        Whether the model is that of the URDF: without rotors and friction.
    """
    if sum(loop.course.windows for loop in loops) < FEWEST_WINDOWS:
        return None
    parts = Parts.of(loops)
    if not parts.held_out:
        return None
    if nominal and not measured:
        # Rows without friction and rotor give gains of something else.
        by_rows = None
    unknowns = first_unknowns(loops, by_rows, measured=measured, nominal=nominal)
    rms_by_rows = np.inf
    if by_rows is None:
        structure = best_structure(parts.rough(), unknowns)
        if structure is None:
            return None
        unknowns = structure.unknowns
        start = solved(parts.fitted, unknowns, structure.solution.theta)
    else:
        start = solved(parts.fitted, unknowns, unknowns.mean)
        rms_by_rows = bounded_rms(parts.judged(unknowns, unknowns.mean))
    coulomb = _friction_size(unknowns, start.theta, loops)
    unknowns, base, terms = with_terms(parts, unknowns, start, coulomb)
    return _finished(loops, smooth, parts, unknowns, base, terms, rms_by_rows, by_rows)


def refitted(
    fit: WindowFit,
    loops: Sequence[JointLoop],
    smooth: Sequence[JointLoop],
    means: Mapping[str, tuple[float, float]],
) -> WindowFit:
    """Return a fit with priors of other servos, where held-out windows do not lose."""
    unknowns = fit.unknowns.centred(means)
    solution = solved(fit.parts.fitted, unknowns, unknowns.mean)
    before = fit.parts.judged(fit.unknowns, fit.solution.theta)
    after = fit.parts.judged(unknowns, solution.theta)
    if gains(after, before):
        return fit
    return _finished(
        loops,
        smooth,
        fit.parts,
        unknowns,
        solution,
        list(fit.terms),
        fit.rms_by_rows,
        fit.by_rows,
    )


def _finished(
    loops: Sequence[JointLoop],
    smooth: Sequence[JointLoop],
    parts: Parts,
    unknowns: Unknowns,
    base: Solved,
    terms: Sequence[str],
    rms_by_rows: float,
    by_rows: JointFit | None,
) -> WindowFit:
    """Fit all windows once more, and describe the result."""
    rms = bounded_rms(parts.judged(unknowns, base.theta))
    whole = solved(loops, unknowns, base.theta)
    given = {} if by_rows is None else given_errors(unknowns, by_rows)
    bias = bias_of_steps(loops, unknowns, whole)
    errors = std_errors(loops, smooth, unknowns, whole, given, bias)
    is_far = distance(unknowns, whole.theta) > PLAUSIBLE
    open_numbers = of_the_prior(unknowns, whole) | is_far
    natural = unknowns.natural((whole.theta - bias)[None])[0]
    values = dict(zip(unknowns.names, natural.tolist(), strict=True))
    scale = np.array([each.positive for each in unknowns.searched])
    stated = np.where(scale, natural * errors, errors)
    return WindowFit(
        values=values,
        std_errors=dict(zip(unknowns.names, stated.tolist(), strict=True)),
        open=tuple(
            name
            for name, is_open in zip(unknowns.names, open_numbers, strict=True)
            if is_open
        ),
        terms=tuple(terms),
        rms=rms,
        rms_by_rows=rms_by_rows,
        rms_of_guess=guess_rms(parts.held_out),
        windows=sum(loop.course.windows for loop in loops),
        solution=base,
        unknowns=unknowns,
        parts=parts,
        by_rows=by_rows,
    )


def first_unknowns(
    loops: Sequence[JointLoop],
    by_rows: JointFit | None,
    *,
    measured: bool,
    nominal: bool,
) -> Unknowns:
    """Return what is searched, with what is known of it before."""
    fixed: dict[str, float] = {}
    searched = []
    if by_rows is None:
        searched += _unknown_gains(loops[0].course)
    elif measured:
        # A torque tells them better than positions do.
        fixed = {name: by_rows.values[name] for name in by_rows.names if name in NAMES}
        delay = _known_delay(by_rows)
        if by_rows.course == "held":
            # When a step came between two rows is seen in what moves after it.
            searched.append(delay)
        else:
            fixed[delay.name] = delay.start
    else:
        searched += _known_gains(by_rows)
    gain = fixed.get(PROPORTIONAL) or searched[0].start
    course = loops[0].course
    error = _usual_error(course)
    torque = gain * error
    offset = 0.0 if by_rows is None else by_rows.offset
    searched.append(
        Unknown(
            name="offset",
            start=offset,
            std=max(torque, 1e-6),
            positive=False,
            step=OFFSET_STEP * max(torque, 1e-6),
        )
    )
    if nominal:
        searched.append(_open("armature", _usual_inertia(course)))
        if measured and by_rows is not None:
            # A torque tells it from the controller's damping.
            damping = max(fixed.get(DERIVATIVE, 0.0), 1e-9)
            searched.append(_open("viscous", USUAL_VISCOUS * damping))
    if loops[0].friction is None:
        searched.append(_open("coulomb", max(USUAL_FRICTION * torque, 1e-9)))
    else:
        searched.append(Unknown(name="friction_factor", start=1.0, std=FRICTION_STD))
    return Unknowns(searched=searched, fixed=fixed)


def _open(name: str, start: float) -> Unknown:
    return Unknown(name=name, start=start, std=OPEN_STD)


def _usual_inertia(course: JointCourse) -> float:
    """Return an inertia [kg m^2] that a joint may have: links are light, rotors not."""
    return max(float(course.inertia.mean()), 1e-2)


def _usual_error(course: JointCourse) -> float:
    """Return the RMS of command less position [rad]."""
    error = course.command(0.0) - course.along
    return max(float(np.sqrt(np.mean(error**2))), 1e-6)


def _unknown_gains(course: JointCourse) -> list[Unknown]:
    """Return gains and delay where the fit by rows says nothing."""
    inertia = float(course.inertia.mean()) + _usual_inertia(course)
    rate = 2.0 * np.pi * USUAL_HZ
    gain = inertia * rate**2
    return [
        _open(PROPORTIONAL, gain),
        replace(_open(DERIVATIVE, 2.0 * USUAL_DAMPING * inertia * rate), std=1.5),
        Unknown(
            name="command_delay",
            start=OPEN_DELAY_S,
            std=OPEN_DELAY_S,
            positive=False,
            step=DELAY_STEP_S,
        ),
    ]


def _known_gains(by_rows: JointFit) -> list[Unknown]:
    """Return gains and delay as the fit by rows has them, without a torque."""
    least = LEAST_STD
    unknowns = []
    for name in (PROPORTIONAL, DERIVATIVE, VELOCITY_FEEDFORWARD, INTEGRAL):
        value = by_rows.values.get(name, 0.0)
        if name not in by_rows.names or not value > 0.0:
            continue
        share = by_rows.std_errors[name] / value
        unknowns.append(Unknown(name=name, start=value, std=max(share, least)))
    if GRAVITY in by_rows.names:
        unknowns.append(
            Unknown(
                name=GRAVITY,
                start=by_rows.values[GRAVITY],
                std=max(by_rows.std_errors[GRAVITY], least),
                positive=False,
            )
        )
    delay = _known_delay(by_rows)
    unknowns.append(replace(delay, std=max(delay.std, LEAST_DELAY_STD_S)))
    return unknowns


def _known_delay(by_rows: JointFit) -> Unknown:
    return Unknown(
        name="command_delay",
        start=by_rows.values["command_delay"],
        std=by_rows.std_errors["command_delay"],
        positive=False,
        step=DELAY_STEP_S,
    )


def _friction_size(
    unknowns: Unknowns, theta: Array, loops: Sequence[JointLoop]
) -> float:
    """Return the size of a joint's friction [N m], about."""
    natural = dict(zip(unknowns.names, unknowns.natural(theta[None])[0], strict=True))
    if "coulomb" in natural:
        return float(natural["coulomb"])
    friction = loops[0].friction
    assert friction is not None
    return max(float(np.abs(friction.forward[:, 0]).mean()), 1e-6)
