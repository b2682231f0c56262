"""One joint of the friction stage: the file's entry, a verdict and notes.

Errors (Eq. 11) are of averages over `group_size` neighbouring slices that belong to their trial: of
inner speeds by a surface that was fitted to the others, of the slowest and the fastest, beyond
which nothing was seen, by the surface itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from numpy.polynomial import Chebyshev

from seqid_cli.identify.friction_surface.fit import SurfaceFit
from seqid_cli.identify.friction_surface.gravity_separation import GravityFit
from seqid_cli.identify.friction_surface.reduction import Orders, SpeedData
from seqid_cli.identify.nuisances import TERM_UNITS, shown, with_even_part
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import (
    FrictionJoint,
    GravityOfTrial,
    Nuisance,
    SpeedLevel,
    Verdict,
)
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

NOISES = 2.0  # of such an average, that count as none of the surface's error
NEAR_ZERO = 0.2  # of the RMS friction, below which the criterion is absolute
DEFAULT_BETA = 0.05
FEWEST_SPEEDS = 4


@dataclass(frozen=True)
class Errors:
    """Errors (E,) N m of averages at scaled speeds `u`, their friction and noise."""

    u: Array
    error: Array
    friction: Array
    noise: Array

    @property
    def missed(self) -> Array:
        """Errors (E,) beyond the noise of the averages."""
        return np.maximum(np.abs(self.error) - NOISES * self.noise, 0.0)

    @property
    def relative(self) -> float:
        """Largest error beyond noise over friction; over 0.2 of its RMS where it is near zero."""
        friction = np.maximum(np.abs(self.friction), NEAR_ZERO * _rms(self.friction))
        return float((self.missed / np.maximum(friction, 1e-300)).max())

    def at(self, u: float) -> "Errors":
        """Those of one speed."""
        own = self.u == u
        return Errors(self.u[own], self.error[own], self.friction[own], self.noise[own])


Part = tuple[list[SpeedData], SurfaceFit]  # of both directions, or of one


def errors_of(parts: list[Part], orders: Orders, *, unseen: bool, group_size: int = 16) -> Errors:
    """Errors of surfaces of some orders that have seen everything, over groups of slices."""
    # If `unseen`, those at inner speeds, of four speeds or more, are of surfaces without them.
    rows = []
    for data, fit in parts:
        whole, leave = fit.entries(orders), unseen and len(fit.reduced.levels) >= FEWEST_SPEEDS
        left_out = dict(fit.leaving_out(orders)) if leave else {}
        phi = fit.reduced.over_speed(orders.velocity)
        for item, u, own in zip(data, fit.reduced.u, phi, strict=True):
            A = fit.reduced.scaling.over_position.values(item.q, orders.position)
            off = item.friction - A @ (left_out.get(float(u), whole) @ own)
            belongs = np.flatnonzero(item.belongs)
            groups = np.array_split(belongs, max(len(belongs) // group_size, 1))
            steps = np.concatenate([np.diff(off[group]) for group in groups])
            scatter = _rms(steps) / np.sqrt(2.0) if len(steps) else 0.0
            rows += [
                (u, off[g].mean(), item.friction[g].mean(), scatter / np.sqrt(len(g)))
                for g in groups
            ]
    return Errors(*np.array(rows).T)


@dataclass(frozen=True)
class Term:
    """A term of a joint's drive, and the change `moves` (k,) N m of entries per unit of it."""

    value: float
    std_error: float
    moves: Array


@dataclass(frozen=True)
class Fit:
    """One joint's friction data, freed of gravity, and the surface fitted to them."""

    gravity: GravityFit
    parts: list[Part]
    orders: Orders
    surface: FrictionSurface
    terms: dict[str, Term]  # "delay" [s], "thermal" [1/K]


def summarise(
    robot: Robot, j: int, fit: Fit, unpaired: int, options: FrictionOptions
) -> tuple[FrictionJoint, Verdict, list[str]]:
    """Describe the fit of joint j; `unpaired` trials had no twin in the other direction."""
    surface, gravity, described = fit.surface, fit.gravity, robot.joints[j]
    fitted = errors_of(fit.parts, fit.orders, unseen=False)
    unseen = errors_of(fit.parts, fit.orders, unseen=True)
    beta = options.beta or DEFAULT_BETA
    levels = _levels(fit, fitted, unseen)
    celsius = mean_celsius(gravity)
    joint = FrictionJoint(
        position_order=fit.orders.position,
        velocity_order=fit.orders.velocity,
        max_error=unseen.relative,
        max_abs_error=float(np.abs(unseen.error).max()),
        rmse=_rms(fitted.error),
        held_out_rmse=_rms(unseen.error) if len(levels) >= FEWEST_SPEEDS else None,
        beta=beta,
        criterion_met=unseen.relative <= beta,
        position_range=list(surface.scaling.position),
        position_basis="fourier" if surface.scaling.periodic else "chebyshev",
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
    verdict = _verdict(described.name, joint, unseen, surface.scaling)
    joint = _with_nuisances(joint, described.name, fit)
    for level in joint.speeds:
        scaled = described.torque_constant_error * level.friction
        level.std_error = float(np.hypot(level.std_error, scaled))
    return joint, verdict, [*_notes(described.name, joint, gravity.groups[0].beyond, unpaired)]


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
    """Return the mean temperature of a joint's trials; None where one of them has none."""
    trials = [trial for group in gravity.groups for trial in group.trials]
    samples = [trial.weight * len(trial.q) for trial in trials]
    celsius = float(np.average([trial.celsius for trial in trials], weights=samples))
    return celsius if np.isfinite(celsius) else None


def _levels(fit: Fit, fitted: Errors, unseen: Errors) -> list[SpeedLevel]:
    """Friction and its errors speed by speed, the slowest first."""
    data = [item for own, _ in fit.parts for item in own]
    speeds = sorted({item.speed for item in data})
    result = []
    for speed, u in zip(speeds, fit.surface.scaling.u(np.array(speeds)), strict=True):
        own = [item for item in data if item.speed == speed]
        inner = len(speeds) >= FEWEST_SPEEDS and speeds[0] < speed < speeds[-1]
        q = np.concatenate([item.q for item in own])
        v = np.repeat([item.direction * speed for item in own], [len(item.q) for item in own])
        level = SpeedLevel(
            speed=speed,
            forward=sum(item.direction > 0 for item in own),
            backward=sum(item.direction < 0 for item in own),
            friction=_rms(fitted.at(u).friction),
            std_error=_rms(fit.surface.std_error(q, v)),
            rmse=_rms(fitted.at(u).error),
            left_out=_rms(unseen.at(u).error) if inner else None,
        )
        result.append(level)
    return result


def _verdict(
    name: str, joint: FrictionJoint, unseen: Errors, scaling: Scaling, *, max_error: float = 0.15
) -> Verdict:
    """Good, or poor and why: the speed at which the surface is worst decides."""
    # There its error may be `max_error` of the friction.
    levels = joint.speeds
    if joint.held_out_rmse is None:
        reason = f"only {len(levels)} speed(s); with four or more one can be left out to judge"
        return Verdict(joint=name, good=False, reason=reason)
    usual = _rms(np.array([level.friction for level in levels]))
    u = scaling.u(np.array([level.speed for level in levels]))
    errors = [
        float(np.hypot(_rms(unseen.at(at).missed), level.std_error))
        / max(level.friction, NEAR_ZERO * usual, 1e-12)
        for at, level in zip(u, levels, strict=True)
    ]
    worst = int(np.argmax(errors))
    unit = "m/s" if joint.unit == "N" else "rad/s"
    at = f"{percent(errors[worst])} at {levels[worst].speed:.3g} {unit}"
    overall = percent(joint.held_out_rmse / max(usual, 1e-12))
    reason = f"speeds left out are predicted to {overall} of the friction; known to {at} or better"
    good = errors[worst] <= max_error
    if not good:
        reason = (
            f"friction is known to {at} only; record more or longer trials there, or look at what "
            "else moves the torque (seqid simultaneous, then seqid diagnose with its file)"
        )
    return Verdict(joint=name, good=good, reason=reason)


def _notes(
    name: str, joint: FrictionJoint, beyond: Chebyshev | None, unpaired: int
) -> Iterator[str]:
    """What is to be said of a joint; `beyond` is torque over the position that is no gravity."""
    if unpaired:
        yield (
            f"{name}: {unpaired} trial(s) have no twin in the other direction in the same "
            "configuration and were left out; Eq. 15 needs both"
        )
    if shown(joint.nuisances, {name: _rms(np.array([x.friction for x in joint.speeds]))}):
        yield (
            f"{name}: friction depends on direction by {percent(joint.asymmetry or 0.0)}, against "
            "the assumption of Eq. 15; offset and asymmetry are part of the surfaces"
        )
    if not joint.criterion_met:
        yield (
            f"{name}: Eq. 11 does not hold at beta = {joint.beta:g}; at left-out speeds the "
            f"largest error is {percent(joint.max_error)} ({joint.max_abs_error:.3g} {joint.unit})"
        )
    if beyond is not None:
        size = float(np.std(beyond(np.linspace(*beyond.domain))))
        yield (
            f"{name}: torque that depends on the position and is no gravity, {size:.3g} "
            f"{joint.unit} RMS and the same both ways, as of a spring or a cable, is taken off the "
            "trials; seqid diagnose tells what it is"
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def constants_note(robot: Robot) -> list[str]:
    """Say which joints' torque constants are taken as exact, if any."""
    known = [joint for joint in robot.joints if joint.torque_constant is not None]
    exact = ", ".join(joint.name for joint in known if joint.torque_constant_error == 0.0)
    note = (
        f"torque constants taken as exact: {exact}; torque_constant_error in the robot file adds "
        "their error to the standard errors"
    )
    return [note] if exact else []
