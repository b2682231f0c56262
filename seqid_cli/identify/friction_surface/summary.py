"""One joint of the friction stage: the file's entry, a verdict and notes.

Errors are of averages over `group_size` neighbouring slices that belong to their trial.
Eq. 11 is the largest of them by the surface itself, relative to the measured friction.
Errors at left-out speeds are at inner speeds those of a surface that was fitted to the
others, at the slowest and the fastest, beyond which nothing was seen, those of the
surface itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from numpy.polynomial import Chebyshev
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.identify.friction_surface.fit import SurfaceFit
from seqid_cli.identify.friction_surface.gravity_separation import GravityFit
from seqid_cli.identify.friction_surface.reduction import Orders, SpeedData
from seqid_cli.identify.nuisances import TERM_UNITS, shown, with_even_part
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.settings import SurfaceSettings
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import (
    FrictionJoint,
    GravityOfTrial,
    Matrix,
    Nuisance,
    SpeedLevel,
    Verdict,
)
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.shares import percent
from seqid_cli.typing import Array

NOISES = 2.0  # of such an average, that count as none of the surface's error
NEAR_ZERO = 0.2  # of the RMS friction, below which the criterion is absolute
DEFAULT_BETA = 0.05
FEWEST_SPEEDS = 4


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors (E,) N m of averages at scaled speeds `u`, and the measured friction.

    `friction` is tau_d of Eq. 11. `noise` is the standard error that the white noise of
    its slices gives an average, `trial_error` the standard deviation of what its trial
    has for itself: an offset, slow changes, an unsteady speed (`prior.Sizes`). `q` is
    the mean position, `direction` that of the motion.
    """

    u: Array
    error: Array
    friction: Array
    noise: Array
    trial_error: Array
    q: Array
    direction: Array

    @property
    def missed(self) -> Array:
        """Errors (E,) beyond the noise of the averages."""
        return np.maximum(np.abs(self.error) - NOISES * self.noise, 0.0)

    @property
    def relative(self) -> float:
        """Left side of Eq. 11: the largest error over the measured friction."""
        return float((np.abs(self.error) / self._denominator).max())

    @property
    def relative_beyond_noise(self) -> float:
        """Relative error after two standard errors were taken off each average."""
        return float((self.missed / self._denominator).max())

    @property
    def relative_of_noise(self) -> float:
        """Median of Eq. 11 that the noise of slices and of trials alone would make.

        Of E independent normal errors the largest is below x with the probability
        prod erf(x / (sqrt(2) s_i)), s_i the standard deviation of average i over its
        friction.
        """
        from scipy.optimize import brentq
        from scipy.special import erf

        spreads = np.hypot(self.noise, self.trial_error) / self._denominator
        largest = float(spreads.max())
        if largest <= 0.0:
            return 0.0
        spreads = spreads[spreads > 1e-6 * largest]

        def probability_over_half(x: float) -> float:
            return float(np.prod(erf(x / (np.sqrt(2.0) * spreads)))) - 0.5

        # Not below half the largest spread: a single such error is so with 38 %.
        return float(brentq(probability_over_half, 0.5 * largest, 10.0 * largest))

    @property
    def _denominator(self) -> Array:
        """Measured friction (E,), held above a floor near zero.

        Eq. 11 asks for another form there.
        """
        floor = max(NEAR_ZERO * rms(self.friction), 1e-300)
        return np.maximum(np.abs(self.friction), floor)

    def at(self, u: float) -> "Errors":
        """Return the errors at one scaled speed."""
        at_speed = self.u == u
        return Errors(
            u=self.u[at_speed],
            error=self.error[at_speed],
            friction=self.friction[at_speed],
            noise=self.noise[at_speed],
            trial_error=self.trial_error[at_speed],
            q=self.q[at_speed],
            direction=self.direction[at_speed],
        )

    def points(self) -> Matrix:
        """Return position, direction, error and its standard error, a row for each."""
        std_error = np.hypot(self.noise, self.trial_error)
        columns = (self.q, self.direction, self.error, std_error)
        return [list(row) for row in np.column_stack(columns).tolist()]


Part = tuple[list[SpeedData], SurfaceFit]  # of both directions, or of one


def errors_of(
    parts: list[Part], orders: Orders, *, unseen: bool, group_size: int = 16
) -> Errors:
    """Return the errors of surfaces of some orders, over groups of slices.

    Parameters
    ----------
    parts : list of Part
        Trials and the surface fitted to them: of both directions, or of one each.
    orders : Orders
        Orders of the surfaces.
    unseen : bool
        Whether the errors at inner speeds, of four speeds or more, are those of
        surfaces that were fitted without the speed.
    group_size : int
        Neighbouring slices that are averaged.
    """
    rows = []
    for data, fit in parts:
        entries_of_all = fit.entries(orders)
        leave_out = unseen and len(fit.reduced.levels) >= FEWEST_SPEEDS
        left_out = dict(fit.leaving_out(orders)) if leave_out else {}
        over_position = fit.reduced.scaling.over_position
        for item, scaled_speed in zip(data, fit.scaled_speeds(data), strict=True):
            u = float(scaled_speed)
            over_speed = chebvander(scaled_speed, orders.velocity).ravel()
            entries = left_out.get(u, entries_of_all)
            columns = over_position.values(item.q, orders.position)
            error = item.friction - columns @ (entries @ over_speed)
            variances = fit.trial_variances(item)
            trial_columns = fit.trial_columns(item)

            belongs = np.flatnonzero(item.belongs)
            groups = np.array_split(belongs, max(len(belongs) // group_size, 1))
            # Differences of neighbours have the white noise of two slices and little
            # else.
            steps = np.concatenate([np.diff(error[group]) for group in groups])
            scatter = rms(steps) / np.sqrt(2.0)
            for group in groups:
                of_trial = trial_columns[group].mean(axis=0) ** 2 @ variances
                noise = scatter / np.sqrt(len(group))
                friction = item.friction[group].mean()
                rows.append(
                    {
                        "u": u,
                        "error": error[group].mean(),
                        "friction": friction,
                        "noise": noise,
                        "trial_error": np.sqrt(of_trial),
                        "q": item.q[group].mean(),
                        "direction": item.direction,
                    }
                )
    return Errors(**{name: np.array([row[name] for row in rows]) for name in rows[0]})


@dataclass(frozen=True)
class Term:
    """A term of a joint's drive.

    `moves` (k,) N m is the change of entries per unit of the term.
    """

    value: float
    std_error: float
    moves: Array


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One joint's friction data, freed of gravity, and the surface fitted to them."""

    gravity: GravityFit
    parts: list[Part]
    orders: Orders
    surface: FrictionSurface
    terms: dict[str, Term]  # "delay" [s], "thermal" [1/K]


def summarise(
    robot: Robot,
    j: int,
    fit: Fit,
    unpaired: int,
    options: FrictionOptions,
    settings: SurfaceSettings,
) -> tuple[FrictionJoint, Verdict, list[str]]:
    """Describe the fit of joint j; `unpaired` trials had no opposite twin."""
    surface = fit.surface
    gravity = fit.gravity
    described = robot.joints[j]

    fitted = errors_of(fit.parts, fit.orders, unseen=False)
    unseen = errors_of(fit.parts, fit.orders, unseen=True)
    beta = DEFAULT_BETA if options.beta is None else options.beta
    levels = _levels(fit, fitted, unseen)
    celsius = mean_celsius(gravity)

    joint = FrictionJoint(
        position_order=fit.orders.position,
        velocity_order=fit.orders.velocity,
        max_error=fitted.relative,
        max_error_beyond_noise=fitted.relative_beyond_noise,
        max_error_of_noise=fitted.relative_of_noise,
        max_error_left_out=unseen.relative if len(levels) >= FEWEST_SPEEDS else None,
        max_abs_error=float(np.abs(unseen.error).max()),
        rmse=rms(fitted.error),
        held_out_rmse=rms(unseen.error) if len(levels) >= FEWEST_SPEEDS else None,
        beta=beta,
        criterion_met=fitted.relative <= beta,
        position_range=list(surface.scaling.position),
        position_basis=surface.scaling.family.name,
        speed_range=list(surface.scaling.speed),
        speed_scale="log" if surface.scaling.logarithmic else "linear",
        sign_width=surface.sign_width,
        directional=surface.directional,
        asymmetry=gravity.asymmetry,
        temperature=celsius,
        positive=surface.positive.tolist(),
        negative=surface.negative.tolist(),
        covariance=surface.entry_covariance.tolist(),
        torque_constant_error=described.torque_constant_error,
        gravity=[
            GravityOfTrial(
                configuration=group.configuration.tolist(),
                p_xi=group.p_xi.tolist(),
                std_error=group.std_error.tolist(),
            )
            for group in gravity.groups
        ],
        speeds=levels,
        unit=described.unit("N m"),
    )
    verdict = _verdict(
        described.name, joint, unseen, surface.scaling, settings.max_error
    )
    joint = _with_nuisances(joint, described.name, fit)

    for level in joint.speeds:
        scaled = described.torque_constant_error * level.friction
        level.std_error = float(np.hypot(level.std_error, scaled))

    notes = list(_notes(described.name, joint, gravity.groups[0].beyond, unpaired))
    if not joint.criterion_met:
        free = options.position_order is None or options.velocity_order is None
        searched = free and options.beta is not None
        notes.append(_criterion_note(described.name, joint, searched=searched))
    return joint, verdict, notes


def _with_nuisances(joint: FrictionJoint, name: str, fit: Fit) -> FrictionJoint:
    """Return the joint's entry with the terms of its drive, known or not."""
    terms = [
        Nuisance(
            name=term_name,
            joint=name,
            value=term.value,
            std_error=term.std_error,
            unit=TERM_UNITS[term_name],
        )
        for term_name, term in fit.terms.items()
    ]
    moves = {term_name: term.moves.tolist() for term_name, term in fit.terms.items()}
    joint = replace(joint, nuisances=terms, term_moves=moves)
    if fit.gravity.friction is None:
        return joint
    return with_even_part(joint, name, fit.gravity.even)


def mean_celsius(gravity: GravityFit) -> float | None:
    """Return the mean temperature of a joint's trials, None if one has none."""
    trials = [trial for group in gravity.groups for trial in group.trials]
    samples = [trial.weight * len(trial.q) for trial in trials]
    celsius = float(np.average([trial.celsius for trial in trials], weights=samples))
    return celsius if np.isfinite(celsius) else None


def _levels(fit: Fit, fitted: Errors, unseen: Errors) -> list[SpeedLevel]:
    """Return friction and its errors speed by speed, the slowest first."""
    data = [item for part_data, _ in fit.parts for item in part_data]
    speeds = sorted({item.speed for item in data})

    result = []
    for speed, u in zip(speeds, fit.surface.scaling.u(np.array(speeds)), strict=True):
        at_speed = [item for item in data if item.speed == speed]
        inner = len(speeds) >= FEWEST_SPEEDS and speeds[0] < speed < speeds[-1]
        q = np.concatenate([item.q for item in at_speed])
        v = np.repeat(
            [item.direction * speed for item in at_speed],
            [len(item.q) for item in at_speed],
        )

        level = SpeedLevel(
            speed=speed,
            forward=sum(item.direction > 0 for item in at_speed),
            backward=sum(item.direction < 0 for item in at_speed),
            friction=rms(fitted.at(u).friction),
            std_error=rms(fit.surface.std_error(q, v)),
            rmse=rms(fitted.at(u).error),
            left_out=rms(unseen.at(u).error) if inner else None,
            points=fitted.at(u).points(),
        )
        result.append(level)
    return result


def _verdict(
    name: str, joint: FrictionJoint, unseen: Errors, scaling: Scaling, max_error: float
) -> Verdict:
    """Return the verdict on a joint: the speed at which the surface is worst decides.

    At that speed its error may be `max_error` of the friction.
    """
    levels = joint.speeds
    if joint.held_out_rmse is None:
        reason = (
            f"only {len(levels)} speed(s); with four or more one can be left out to"
            " judge"
        )
        return Verdict(joint=name, good=False, reason=reason)

    usual = rms(np.array([level.friction for level in levels]))
    u = scaling.u(np.array([level.speed for level in levels]))
    errors = [
        float(np.hypot(rms(unseen.at(at).missed), level.std_error))
        / max(level.friction, NEAR_ZERO * usual, 1e-12)
        for at, level in zip(u, levels, strict=True)
    ]
    worst = int(np.argmax(errors))

    unit = "m/s" if joint.unit == "N" else "rad/s"
    at = f"{percent(errors[worst])} at {levels[worst].speed:.3g} {unit}"
    overall = percent(joint.held_out_rmse / max(usual, 1e-12))
    reason = (
        f"speeds left out are predicted to {overall} of the friction; known to {at} or"
        " better"
    )
    good = errors[worst] <= max_error
    if not good:
        reason = (
            f"friction is known to {at} only; record more or longer trials there, or"
            " look at what else moves the torque (seqid simultaneous, then seqid"
            " diagnose with its file)"
        )
    return Verdict(joint=name, good=good, reason=reason)


def _notes(
    name: str, joint: FrictionJoint, beyond: Chebyshev | None, unpaired: int
) -> Iterator[str]:
    """Return the notes on a joint.

    `beyond` is torque over the position that is no gravity.
    """
    if unpaired:
        yield (
            f"{name}: {unpaired} trial(s) have no twin in the other direction in the"
            " same configuration and were left out; Eq. 15 needs both"
        )
    if shown(
        joint.nuisances, {name: rms(np.array([x.friction for x in joint.speeds]))}
    ):
        yield (
            f"{name}: friction depends on direction by"
            f" {percent(joint.asymmetry or 0.0)}, against the assumption of Eq. 15;"
            " offset and asymmetry are part of the surfaces"
        )
    if beyond is not None:
        size = float(np.std(beyond(np.linspace(*beyond.domain))))
        yield (
            f"{name}: torque that depends on the position and is no gravity, {size:.3g}"
            f" {joint.unit} RMS and the same both ways, as of a spring or a cable, is"
            " taken off the trials; seqid diagnose tells what it is"
        )


def _criterion_note(name: str, joint: FrictionJoint, *, searched: bool) -> str:
    """Say by how much Eq. 11 is missed, what noise makes of that, and what was done.

    `searched` is whether orders were raised to meet it, up to the highest, and in vain.
    """
    text = (
        f"{name}: Eq. 11 does not hold at beta = {joint.beta:g}: the largest error is"
        f" {percent(joint.max_error)} of the friction; the noise of its averages alone"
        f" makes {percent(joint.max_error_of_noise or 0.0)}"
    )
    if not searched:
        return text
    orders = f"({joint.position_order}, {joint.velocity_order})"
    return f"{text}; no orders meet it, and the data support none beyond {orders}"
