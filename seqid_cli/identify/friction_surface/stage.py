"""Friction stage (Sec. 2.2.1-2.2.2, Eq. 7-16): a surface per joint from steady motion.

Three passes lead to a joint's surface:

1. Gravity is separated from pairs of trials, forward and backward (Eq. 12-15), and a
   first surface is fitted to what is left. By it, trials in which the joint hunts
   between counts of its encoder are left out.
2. The first surfaces of all joints tell what acceleration is left in the trials, and
   by how much held joints gave way (`corrections`). Gravity is separated once more.
3. The final surface is fitted to friction by Eq. 16, on the likeliest of some bases.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.friction_surface import gravity_separation, reduction, summary
from seqid_cli.identify.friction_surface.corrections import (
    HeldJoints,
    without_acceleration,
)
from seqid_cli.identify.friction_surface.fit import (
    FixedOrders,
    SurfaceFit,
    choose_orders,
    fit_surfaces,
)
from seqid_cli.identify.friction_surface.gravity_separation import (
    GravityFit,
    GravityGroup,
)
from seqid_cli.identify.friction_surface.hunting import note_on_hunting, sliding_trials
from seqid_cli.identify.friction_surface.prior import Sizes
from seqid_cli.identify.friction_surface.reduction import SpeedData
from seqid_cli.identify.friction_surface.trials import (
    Trial,
    collect_trials,
    kelvin_of,
    speed_levels,
)
from seqid_cli.identify.log_set import paths_of
from seqid_cli.identify.nuisances import PRIORS
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.settings import FrictionSettings, SurfaceSettings
from seqid_cli.identify.tolerances import constants_note
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionJoint, FrictionStage, Verdict
from seqid_cli.position_families import FAMILIES
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

NO_TRIAL = "no constant-velocity trial moves this joint"
STUCK = "the torque of this joint is one and the same in all of its moves"
UNPAIRED = "no pair of forward and backward trials at one speed in one configuration"
# The surface is fitted once per entry: slices that do not belong to their trial lose
# their weight round by round. Only in the last round, whose data are clean, are all
# bases tried.
TRIES_ALL_BASES = (False, False, True)
# Temperature is told apart from speed where at least this share of its variance lies
# within trials of one speed and direction.
LEAST_WITHIN_SHARE = 0.1
# Speeds that span more than this ratio may want their logarithm.
WIDE_SPEED_RANGE = 4.0


def identify_friction(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: FrictionOptions,
    settings: FrictionSettings = FrictionSettings(),
) -> FrictionStage:
    """Identify the friction surface of every joint that moves at constant velocity.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs in which one joint at a time moves at constant speed, both ways.
    robot : Robot
    options : FrictionOptions
        Orders that the user fixes, and the bound beta of Eq. 11.
    settings : FrictionSettings

    Returns
    -------
    FrictionStage
        Surfaces of the joints that have any, a verdict on every joint, and notes.

    Raises
    ------
    QualityError
        If no joint moves by itself at constant velocity, no trial has a twin in the
        other direction, or the orders ask for more speeds than there are.
    """
    trials = collect_trials(recordings, robot)
    if not trials:
        raise _no_trials(recordings)

    first = _first_pass(robot, trials, options, settings)
    surfaces = [
        first.fits[j].surface if j in first.fits else None for j in range(robot.n)
    ]
    held = HeldJoints.of(robot, first.sliding_trials, surfaces)

    joints: dict[str, FrictionJoint] = {}
    verdicts: list[Verdict] = []
    notes = first.notes
    for j, joint in enumerate(robot.joints):
        verdict = Verdict(joint=joint.name, good=False, reason=first.reasons[j])
        first_fit = first.fits.get(j)
        gravity = _steady_gravity(robot, first_fit, held) if first_fit else None
        if first_fit is not None and gravity is not None and gravity.groups:
            fit = _fit(
                robot,
                j,
                gravity,
                options,
                settings.surface,
                near=first_fit.parts[0][1].sizes,
                held=held,
            )
            n_unpaired = first_fit.gravity.unpaired
            joints[joint.name], verdict, joint_notes = summary.summarise(
                robot, j, fit, n_unpaired, options, settings.surface
            )
            notes += joint_notes
        verdicts.append(verdict)
    if not joints:
        raise _no_surface(robot, first)
    notes += constants_note(robot)
    return FrictionStage(joints=joints, verdicts=verdicts, notes=notes)


def _no_trials(recordings: Iterable[Recording]) -> QualityError:
    """Return the error of logs in which no joint moves alone at constant velocity."""
    logs = [str(path) for path in paths_of(recordings)]
    where = "".join(logs[:1])
    if len(logs) > 1:
        where += f" and {len(logs) - 1} more"
    return QualityError(
        "no stretch was found in which one joint moves by itself at constant velocity",
        hint=(
            "record trapezoidal moves of one joint at a time, or use seqid simultaneous"
        ),
        where=where,
    )


@dataclass(frozen=True, kw_only=True)
class FirstPass:
    """First estimates of the joints' friction, by the joint's number.

    `reasons` says of every joint why it would have no surface; `sliding_trials` are
    those in which the joint does not hunt.
    """

    fits: dict[int, summary.Fit]
    sliding_trials: list[Trial]
    reasons: dict[int, str]
    notes: list[str]


def _first_pass(
    robot: Robot,
    trials: list[Trial],
    options: FrictionOptions,
    settings: FrictionSettings,
) -> FirstPass:
    """Fit a first surface to every joint, without the trials in which it hunts."""
    fits: dict[int, summary.Fit] = {}
    all_sliding: list[Trial] = []
    reasons = dict.fromkeys(range(robot.n), NO_TRIAL)
    notes: list[str] = []
    for j in sorted({trial.joint for trial in trials}):
        joint_trials = [trial for trial in trials if trial.joint == j]
        if _is_stuck(joint_trials):
            reasons[j] = STUCK
            continue
        reasons[j] = UNPAIRED
        fit = _first_fit(robot, j, joint_trials, options, settings)
        sliding = sliding_trials(robot, joint_trials, fit, settings.hunting)
        if len(sliding) < len(joint_trials):
            note = note_on_hunting(robot.joints[j], joint_trials, sliding)
            notes.append(note)
            fit = _first_fit(robot, j, sliding, options, settings)
            reasons[j] = note if fit is None else UNPAIRED
        all_sliding += sliding
        if fit is not None:
            fits[j] = fit
    return FirstPass(
        fits=fits, sliding_trials=all_sliding, reasons=reasons, notes=notes
    )


def _is_stuck(trials: Sequence[Trial]) -> bool:
    """Return whether all trials have one torque: then nothing is known of friction."""
    torque = np.concatenate([trial.tau for trial in trials])
    return bool(np.ptp(torque) == 0.0)


def _no_surface(robot: Robot, first: FirstPass) -> QualityError:
    """Return the error of logs without a surface, naming the last moved joint."""
    remedies = {
        UNPAIRED: "record every speed in both directions over the same range (Eq. 15)",
        STUCK: "look at the torque channel: seqid inspect says what it holds",
    }
    for reason, remedy in remedies.items():
        names = [
            robot.joint_names[j]
            for j, reason_of_joint in first.reasons.items()
            if reason_of_joint == reason
        ]
        if names:
            return QualityError(reason, hint=remedy, where=f"joint {names[-1]}")
    return QualityError(first.notes[-1], hint="no joint slides in these logs")


def _first_fit(
    robot: Robot,
    j: int,
    trials: list[Trial],
    options: FrictionOptions,
    settings: FrictionSettings,
) -> summary.Fit | None:
    """Return a first estimate of a joint's friction, None without paired trials."""
    if not trials:
        return None
    groups = gravity_separation.configurations(trials, settings.trials)
    gravity = gravity_separation.fit_gravity(robot, groups)
    if not gravity.groups:
        return None
    return _fit(robot, j, gravity, options, settings.surface)


def _steady_gravity(
    robot: Robot, first_fit: summary.Fit, held: HeldJoints
) -> GravityFit:
    """Separate gravity again, without acceleration and held joints' play."""
    stood = [held.standing(group.trials) for group in first_fit.gravity.groups]
    steady = without_acceleration(robot, stood, first_fit.surface)
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
    """Fit a joint's surface to its trials freed of gravity.

    Parameters
    ----------
    robot : Robot
    j : int
        The joint.
    gravity : GravityFit
        What the trials have alike both ways.
    options : FrictionOptions
    settings : SurfaceSettings
    near : Sizes, optional
        Sizes of terms and errors that an earlier fit has found. With them all bases
        are tried, without them the first alone.
    held : HeldJoints, optional
        What held joints gave way by; without it nothing is known of that.
    """
    # One surface for both directions together: what is alike both ways has been taken
    # off.
    data = _friction_data(gravity, held)
    fixed_orders = (options.position_order, options.velocity_order)
    _check_speeds(robot, j, data, options.velocity_order)
    scalings = _scalings(data)
    if near is None:
        scalings = scalings[:1]
    parts = _fitted(data, scalings, fixed_orders, near)
    fits = [fit for _, fit in parts]

    def meets_criterion(orders: reduction.Orders) -> bool:
        """Return whether Eq. 11 holds."""
        errors = summary.errors_of(parts, orders, unseen=False)
        return options.beta is not None and errors.relative <= options.beta

    orders = choose_orders(
        fits,
        fixed_orders,
        accept=None if options.beta is None else meets_criterion,
    )
    entries = fits[0].entries(orders)
    scaling = fits[0].reduced.scaling
    surface = FrictionSurface(
        scaling=scaling,
        sign_width=scaling.speed[0] / settings.sign_narrowness,
        positive=entries,
        negative=entries,
        entry_covariance=fits[0].covariance(orders),
        directional=False,
    )

    # The fit's columns hold one prior standard deviation of a term each.
    prior_std = {"delay": PRIORS.delay_s, "thermal": PRIORS.per_kelvin}
    places = {"delay": reduction.LATE, "thermal": reduction.WARM}
    terms = {}
    for name, std in prior_std.items():
        shared = fits[0].shared_term(orders, places[name])
        terms[name] = summary.Term(
            value=std * shared.value,
            std_error=std * shared.std_error,
            moves=shared.moves / std,
        )
    if not _tells_temperature(gravity):
        surface, terms["thermal"] = _marginalised(surface, terms["thermal"])
    return summary.Fit(
        gravity=gravity, parts=parts, orders=orders, surface=surface, terms=terms
    )


def _check_speeds(
    robot: Robot, j: int, data: list[SpeedData], velocity_order: int | None
) -> None:
    """Raise QualityError where there are too few speeds for `velocity_order`."""
    n_speeds = len({item.speed for item in data})
    if velocity_order is None or velocity_order + 1 <= n_speeds:
        return
    raise QualityError(
        f"velocity order {velocity_order} needs at least {velocity_order + 1} speeds,"
        f" these logs hold {n_speeds}",
        hint=f"record more speeds or use --velocity-order {n_speeds - 1} or less",
        where=f"joint {robot.joints[j].name}",
    )


def _tells_temperature(gravity: GravityFit) -> bool:
    """Return whether trials at one speed and direction differ in temperature.

    A joint warms up while its speeds are recorded one after the other. Temperature and
    speed then say the same, and how smooth friction is over the speed decides between
    them: the trials do not.
    """
    trials = [trial for group in gravity.groups for trial in group.trials]
    celsius = np.array([trial.celsius for trial in trials])
    if not np.isfinite(celsius).all():
        return True  # nothing depends on it
    total = float(np.sum((celsius - celsius.mean()) ** 2))
    within = 0.0
    for level in speed_levels(trials):
        for direction in (1, -1):
            same_way = [
                trial.celsius for trial in level if direction * trial.velocity > 0.0
            ]
            if same_way:
                within += float(np.sum((np.array(same_way) - np.mean(same_way)) ** 2))
    return within >= LEAST_WITHIN_SHARE * total


def _marginalised(
    surface: FrictionSurface, term: summary.Term
) -> tuple[FrictionSurface, summary.Term]:
    """Return a surface and its thermal term as if trials did not show the term."""
    variance = PRIORS.per_kelvin**2 - term.std_error**2
    covariance = surface.entry_covariance + variance * np.outer(term.moves, term.moves)
    return (
        replace(surface, entry_covariance=covariance),
        replace(term, std_error=PRIORS.per_kelvin),
    )


def _fitted(
    data: list[SpeedData],
    scalings: list[Scaling],
    fixed_orders: FixedOrders,
    near: Sizes | None,
) -> list[summary.Part]:
    """Fit a joint's surface on the likeliest basis, slices that do not belong left out.

    Sizes of terms and errors are searched from those of the round before, first from
    `near`.
    """
    distances = reduction.around_medians(data)
    for tries_all_bases in TRIES_ALL_BASES:
        weighted = reduction.weighted(data, distances)
        tried: list[tuple[float, SurfaceFit]] = []
        for scaling in scalings if tries_all_bases else scalings[:1]:
            reduced = reduction.reduce_trials(weighted, scaling)
            fits, evidence = fit_surfaces([reduced], fixed_orders, near)
            if np.isfinite(evidence):
                tried.append((evidence, fits[0]))
        if not tried:
            raise QualityError(
                "friction cannot be fitted: the torque of a trial is no number",
                hint="seqid inspect says what is wrong with the torque channel",
            )
        _, fit = max(tried, key=lambda pair: pair[0])
        near = fit.sizes
        distances = fit.distances(data)
    return [(weighted, fit)]


def _scalings(data: list[SpeedData]) -> list[Scaling]:
    """Return candidate bases: by families over position, by speeds or logarithms."""
    q = np.concatenate([item.q for item in data])
    speeds = [item.speed for item in data]
    position = (float(q.min()), float(q.max()))
    speed = (min(speeds), max(speeds))
    over_speed = [False]
    if speed[0] * WIDE_SPEED_RANGE < speed[1]:
        over_speed.append(True)
    over_position = [family for family in FAMILIES if family.is_tried(*position)]
    return [
        Scaling(position, speed, logarithmic, family)
        for family in over_position
        for logarithmic in over_speed
    ]


def _friction_data(gravity: GravityFit, held: HeldJoints | None) -> list[SpeedData]:
    """Return friction by Eq. 16, one entry per trial, at its level's mean speed."""
    entries = list(_trial_entries(gravity, held))
    data = []
    for level in speed_levels(entries):
        mean_speed = float(np.mean([entry.speed for entry in level]))
        data += [replace(entry, speed=mean_speed) for entry in level]
    return data


def _trial_entries(gravity: GravityFit, held: HeldJoints | None) -> Iterator[SpeedData]:
    """Yield the friction of every trial, and its change with known errors."""
    celsius = summary.mean_celsius(gravity)
    for posture, group in enumerate(gravity.groups):
        doubts = [0.0 * trial.q for trial in group.trials]
        if held is not None:
            doubts = held.doubt(group.trials)
        for trial, doubt in zip(group.trials, doubts, strict=True):
            entry = _trial_entry(trial, group, gravity, doubt=doubt, celsius=celsius)
            yield replace(entry, posture=posture)


def _trial_entry(
    trial: Trial,
    group: GravityGroup,
    gravity: GravityFit,
    *,
    doubt: Array,
    celsius: float | None,
) -> SpeedData:
    """Return the friction of one trial.

    `doubt` (K,) N m is the uncertainty of how far held joints gave way.
    """
    direction = 1 if trial.velocity > 0 else -1
    gravity_torque = group.torque(trial.q)
    even_torque = gravity.even_torque(trial.q, trial.speed)
    warmth = _thermal_friction(trial, gravity) * kelvin_of(trial, celsius)
    return SpeedData(
        speed=trial.speed,
        direction=direction,
        q=trial.q,
        friction=direction * (trial.tau - (gravity_torque + even_torque)),
        weight=np.full(len(trial.q), trial.weight),
        edges=reduction.edges_of(trial.t, trial.seconds),
        push=direction * trial.inertia_error * trial.ddq,
        doubt=doubt,
        late=-PRIORS.delay_s * trial.speed * group.slope(trial.q),
        warm=PRIORS.per_kelvin * warmth,
    )


def _thermal_friction(trial: Trial, gravity: GravityFit) -> Array:
    """Return the friction (K,) N m of a trial that goes with the temperature."""
    if gravity.friction is None:
        return np.full(len(trial.q), float(np.median(np.abs(trial.tau))))
    return gravity.friction.torque(trial.q, trial.speed)
