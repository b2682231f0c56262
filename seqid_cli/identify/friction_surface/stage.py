"""Friction stage (Sec. 2.2.1-2.2.2, Eq. 7-16): one surface per joint from steady motion."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.friction_surface import gravity_separation, reduction, summary
from seqid_cli.identify.friction_surface.corrections import (
    HeldJoints,
    without_acceleration,
)
from seqid_cli.identify.friction_surface.fit import Asked, choose_orders, fit_surfaces
from seqid_cli.identify.friction_surface.gravity_separation import GravityFit
from seqid_cli.identify.friction_surface.hunting import note_on_hunting, sliding_trials
from seqid_cli.identify.friction_surface.prior import Sizes
from seqid_cli.identify.friction_surface.trials import (
    Trial,
    collect_trials,
    kelvin_of,
    speed_levels,
)
from seqid_cli.identify.nuisances import PRIORS
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.settings import FrictionSettings, SurfaceSettings
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionStage, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

UNPAIRED = "no pair of forward and backward trials at one speed in one configuration"


def identify_friction(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: FrictionOptions,
    settings: FrictionSettings = FrictionSettings(),
) -> FrictionStage:
    """Identify the friction surface of every joint that the logs move at constant velocity.

    Raises QualityError if no joint moves by itself at constant velocity, no trial has a
    twin in the other direction, or the orders ask for more speeds than there are.
    """
    trials = collect_trials(recordings, robot)
    if not trials:
        logs = [
            str(getattr(log, "path", log))
            for log in getattr(recordings, "logs", recordings)
        ]
        raise QualityError(
            "no stretch was found in which one joint moves by itself at constant"
            " velocity",
            hint=(
                "record trapezoidal moves of one joint at a time, or use seqid"
                " simultaneous"
            ),
            where="".join(logs[:1]) + f" and {len(logs) - 1} more" * (len(logs) > 1),
        )
    firsts: dict[int, summary.Fit] = {}
    reasons = dict.fromkeys(
        range(robot.n), "no constant-velocity trial moves this joint"
    )
    joints, verdicts, notes = {}, [], []
    sliding: list[Trial] = []
    for j in sorted({trial.joint for trial in trials}):
        reasons[j] = UNPAIRED
        own = [trial for trial in trials if trial.joint == j]
        first = _first_fit(robot, j, own, options, settings)
        slides = sliding_trials(robot, own, first, settings.hunting)
        if len(slides) < len(own):
            text = note_on_hunting(robot.joints[j], own, slides)
            notes.append(text)
            first = _first_fit(robot, j, slides, options, settings)
            reasons[j] = text if first is None else UNPAIRED
        sliding += slides
        if first is not None:
            firsts[j] = first
    surfaces = [firsts[j].surface if j in firsts else None for j in range(robot.n)]
    held = HeldJoints.of(robot, sliding, surfaces)
    for j, joint in enumerate(robot.joints):
        first, verdict = (
            firsts.get(j),
            Verdict(joint=joint.name, good=False, reason=reasons[j]),
        )
        steady = _steady_gravity(robot, first, held) if first else None
        if first and steady and steady.groups:
            sizes = first.parts[0][1].sizes
            fit = _fit(
                robot, j, steady, options, settings.surface, near=sizes, held=held
            )
            unpaired = first.gravity.unpaired
            joints[joint.name], verdict, said = summary.summarise(
                robot, j, fit, unpaired, options, settings.surface
            )
            notes += said
        verdicts.append(verdict)
    if not joints:
        hint = "record every speed in both directions over the same range (Eq. 15)"
        names = [
            robot.joint_names[j] for j, reason in reasons.items() if reason == UNPAIRED
        ]
        if not names:
            raise QualityError(notes[-1], hint="no joint slides in these logs")
        raise QualityError(UNPAIRED, hint=hint, where=f"joint {names[-1]}")
    notes += summary.constants_note(robot)
    return FrictionStage(joints=joints, verdicts=verdicts, notes=notes)


def _first_fit(
    robot: Robot,
    j: int,
    trials: list[Trial],
    options: FrictionOptions,
    settings: FrictionSettings,
) -> summary.Fit | None:
    """Return a first estimate of a joint's friction; None where no trials are paired."""
    if not trials:
        return None
    groups = gravity_separation.configurations(trials, settings.trials)
    gravity = gravity_separation.fit_gravity(robot, groups)
    if not gravity.groups:
        return None
    return _fit(robot, j, gravity, options, settings.surface)


def _steady_gravity(robot: Robot, first: summary.Fit, held: HeldJoints) -> GravityFit:
    """Gravity once more: first surfaces show what acceleration is left, and how others gave way."""
    stood = [held.standing(group.trials) for group in first.gravity.groups]
    steady = without_acceleration(robot, stood, first.surface)
    return gravity_separation.fit_gravity(robot, [group.trials for group in steady])


def _fit(
    robot: Robot,
    j: int,
    gravity: GravityFit,
    options: FrictionOptions,
    settings: SurfaceSettings,
    *,
    near: Sizes | None = None,
    held: HeldJoints | None = None,
) -> summary.Fit:
    """Fit a joint's surface; on the likeliest of all bases if sizes are known that are `near`."""
    # One surface for both directions together: what is alike both ways has been taken
    # off.
    data, asked = (
        _friction_data(gravity, held),
        (options.position_order, options.velocity_order),
    )
    levels = len({item.speed for item in data})
    if asked[1] is not None and asked[1] + 1 > levels:
        needed = f"velocity order {asked[1]} needs at least {asked[1] + 1} speeds"
        hint = f"record more speeds or use --velocity-order {levels - 1} or less"
        where = f"joint {robot.joints[j].name}"
        raise QualityError(
            f"{needed}, these logs hold {levels}", hint=hint, where=where
        )
    parts = _fitted(
        [data], _scalings(data) if near else _scalings(data)[:1], asked, near
    )
    fits, beta = [fit for _, fit in parts], options.beta

    def meets_criterion(orders: reduction.Orders) -> bool:
        """Return whether Eq. 11 holds, where there is a beta that it may hold at."""
        errors = summary.errors_of(parts, orders, unseen=False)
        return beta is not None and errors.relative <= beta

    chosen = choose_orders(
        fits, asked, accept=None if beta is None else meets_criterion
    )
    entries = fits[0].entries(chosen)
    scaling = fits[0].reduced.scaling
    units = {"delay": PRIORS.delay_s, "thermal": PRIORS.per_kelvin}
    places = {"delay": reduction.LATE, "thermal": reduction.WARM}
    surface = FrictionSurface(
        scaling=scaling,
        sign_width=scaling.speed[0] / settings.sign_narrowness,
        positive=entries,
        negative=entries,
        entry_covariance=fits[0].covariance(chosen),
        directional=False,
    )
    terms = {}
    for name, unit in units.items():
        shared = fits[0].shared_term(chosen, places[name])
        terms[name] = summary.Term(
            value=unit * shared.value,
            std_error=unit * shared.std_error,
            moves=shared.moves / unit,
        )
    if not _tells_temperature(gravity):
        surface, terms["thermal"] = _marginalised(surface, terms["thermal"])
    return summary.Fit(gravity, parts, chosen, surface, terms)


def _tells_temperature(gravity: GravityFit, *, least_share: float = 0.1) -> bool:
    """Whether trials at one speed, one way, were recorded at temperatures that differ.

    A joint warms up while its speeds are recorded one after the other. Temperature and
    speed then say the same, and how smooth friction is over the speed decides between
    them: the trials do not. `least_share` of the temperatures' variance must lie within
    speeds and directions.
    """
    trials = [trial for group in gravity.groups for trial in group.trials]
    celsius = np.array([trial.celsius for trial in trials])
    if not np.isfinite(celsius).all():
        return True  # nothing depends on it
    total = float(np.sum((celsius - celsius.mean()) ** 2))
    within = 0.0
    for level in speed_levels(trials):
        for way in (1, -1):
            alike = np.array([t.celsius for t in level if way * t.velocity > 0.0])
            within += float(np.sum((alike - alike.mean()) ** 2)) if len(alike) else 0.0
    return within >= least_share * total


def _marginalised(
    surface: FrictionSurface, term: summary.Term
) -> tuple[FrictionSurface, summary.Term]:
    """Return a surface, and its thermal term, as if the trials had said nothing of the term."""
    variance = PRIORS.per_kelvin**2 - term.std_error**2
    covariance = surface.entry_covariance + variance * np.outer(term.moves, term.moves)
    return (
        replace(surface, entry_covariance=covariance),
        replace(term, std_error=PRIORS.per_kelvin),
    )


def _fitted(
    sets: list[list[reduction.SpeedData]],
    scalings: list[Scaling],
    asked: Asked,
    near: Sizes | None,
) -> list[summary.Part]:
    """Fit on the likeliest basis; slices that do not belong lose their weight round by round."""
    # Sizes of terms and errors are searched from those of the round before, first from
    # `near`.
    distances = [reduction.around_medians(own) for own in sets]
    for last in (False, False, True):
        data = [
            reduction.weighted(own, off)
            for own, off in zip(sets, distances, strict=True)
        ]
        tried = [
            fit_surfaces(
                [reduction.reduce_trials(own, scaling) for own in data], asked, near
            )
            for scaling in (scalings if last else scalings[:1])
        ]
        fits = max(tried, key=lambda each: each[1])[0]
        near = fits[0].sizes
        distances = [fit.distances(own) for own, fit in zip(sets, fits, strict=True)]
    return list(zip(data, fits, strict=True))


def _scalings(
    data: list[reduction.SpeedData], *, wide_range: float = 4.0
) -> list[Scaling]:
    """Bases that may suit: speeds or their logarithms, positions of one range or of every turn."""
    q, speeds = np.concatenate([item.q for item in data]), [item.speed for item in data]
    low, high, slow, fast = float(q.min()), float(q.max()), min(speeds), max(speeds)
    return [
        Scaling((low, high), (slow, fast), logarithmic, periodic)
        for periodic in ((False, True) if high - low > 2.0 * np.pi else (False,))
        for logarithmic in ((False, True) if slow * wide_range < fast else (False,))
    ]


def _friction_data(
    gravity: GravityFit, held: HeldJoints | None
) -> list[reduction.SpeedData]:
    """Friction by Eq. 16, one entry per trial, all trials of a level at the level's mean speed."""
    data = []
    celsius = summary.mean_celsius(gravity)
    for group in gravity.groups:
        doubts = (
            held.doubt(group.trials)
            if held
            else [0.0 * trial.q for trial in group.trials]
        )
        for trial, doubt in zip(group.trials, doubts, strict=True):
            way = 1 if trial.velocity > 0 else -1
            same_both_ways = group.torque(trial.q) + gravity.even_torque(
                trial.q, trial.speed
            )
            item = reduction.SpeedData(
                speed=trial.speed,
                direction=way,
                q=trial.q,
                friction=way * (trial.tau - same_both_ways),
                weight=np.full(len(trial.q), trial.weight),
                edges=reduction.edges_of(trial.t, trial.seconds),
                push=way * trial.inertia_error * trial.ddq,
                doubt=doubt,
                late=-PRIORS.delay_s * trial.speed * group.slope(trial.q),
                warm=PRIORS.per_kelvin
                * _warmth(trial, gravity)
                * kelvin_of(trial, celsius),
            )
            data.append(item)
    return [
        replace(item, speed=float(np.mean([other.speed for other in level])))
        for level in speed_levels(data)
        for item in level
    ]


def _warmth(trial: Trial, gravity: GravityFit) -> Array:
    """Return the friction (K,) N m of a trial that goes with the temperature."""
    if gravity.friction is None:
        return np.full(len(trial.q), float(np.median(np.abs(trial.tau))))
    return gravity.friction.torque(trial.q, trial.speed)
