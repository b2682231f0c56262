"""One joint of the friction stage: the file's entry, a verdict and notes.

Errors (Eq. 11) are of averages over `group_size` neighbouring slices that belong to their trial: of
inner speeds by a surface that was fitted to the others, of the slowest and the fastest, beyond
which nothing was seen, by the surface itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.friction_surface.fit import SurfaceFit
from seqid_cli.identify.friction_surface.gravity_separation import GravityFit
from seqid_cli.identify.friction_surface.reduction import COUNTS, Orders, SpeedData
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionJoint, GravityOfTrial, SpeedLevel, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

NOISES = 2.0  # of such an average, that count as none of the surface's error
NEAR_ZERO = 0.2  # of the RMS friction, below which the criterion is absolute


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
    def rms(self) -> float:
        """RMS error, N m."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def relative(self) -> float:
        """Largest error beyond noise over friction; over 0.2 of its RMS where it is near zero."""
        friction = np.maximum(np.abs(self.friction), NEAR_ZERO * np.sqrt(np.mean(self.friction**2)))
        return float((self.missed / np.maximum(friction, 1e-300)).max())

    def at(self, u: float) -> "Errors":
        """Those of one speed."""
        own = self.u == u
        return Errors(self.u[own], self.error[own], self.friction[own], self.noise[own])


Part = tuple[list[SpeedData], SurfaceFit]  # of both directions, or of one


def errors_of(parts: Sequence[Part], orders: Orders, *, unseen: bool) -> Errors:
    """Errors of surfaces of some orders that have seen everything.

    If `unseen`, those at inner speeds are of surfaces that have not seen them. With three speeds or
    fewer nothing is left out.
    """
    rows = []
    for data, fit in parts:
        levels, over_position = fit.reduced.levels, fit.reduced.scaling.over_position
        left_out = dict(fit.leaving_out(orders)) if unseen and len(levels) > 3 else {}
        phi = np.polynomial.chebyshev.chebvander(levels, orders.velocity)
        whole = fit.entries(orders)
        for u, own in zip(levels, phi, strict=True):
            at_speed = left_out.get(float(u), whole) @ own
            for item, at in zip(data, fit.reduced.u, strict=True):
                if at == u:
                    fitted = over_position.values(item.q, orders.position) @ at_speed
                    error, friction, noise = _grouped(item, fitted)
                    rows.append((np.full(len(error), u), error, friction, noise))
    return Errors(*(np.concatenate(values) for values in zip(*rows, strict=True)))


def _grouped(item: SpeedData, fitted: Array, *, group_size: int = 16) -> tuple[Array, Array, Array]:
    """Errors and friction averaged over groups of slices, and the noise of such an average."""
    belongs = np.flatnonzero(item.weight > COUNTS * item.weight.max())
    groups = np.array_split(belongs, max(len(belongs) // group_size, 1))
    off = item.friction - fitted
    steps = np.concatenate([np.diff(off[group]) for group in groups])
    scatter = float(np.sqrt(np.mean(steps**2) / 2.0)) if len(steps) else 0.0
    error = np.array([off[group].mean() for group in groups])
    friction = np.array([item.friction[group].mean() for group in groups])
    return error, friction, scatter / np.sqrt([float(len(group)) for group in groups])


DEFAULT_BETA = 0.05
FEWEST_SPEEDS = 4


@dataclass(frozen=True)
class Fit:
    """One joint's friction data, freed of gravity, and the surface fitted to them."""

    gravity: GravityFit
    parts: list[Part]
    orders: Orders
    surface: FrictionSurface


def summarise(
    robot: Robot, j: int, fit: Fit, unpaired: int, options: FrictionOptions
) -> tuple[FrictionJoint, Verdict, list[str]]:
    """Describe the fit of joint j; `unpaired` trials had no twin in the other direction."""
    surface, gravity = fit.surface, fit.gravity
    fitted = errors_of(fit.parts, fit.orders, unseen=False)
    unseen = errors_of(fit.parts, fit.orders, unseen=True)
    beta = options.beta or DEFAULT_BETA
    levels = _levels(fit, fitted, unseen)
    trials = [trial for group in gravity.groups for trial in group.trials]
    samples = [trial.weight * len(trial.q) for trial in trials]  # NaN where one has no temperature
    celsius = float(np.average([trial.celsius for trial in trials], weights=samples))
    joint = FrictionJoint(
        position_order=fit.orders.position,
        velocity_order=fit.orders.velocity,
        max_error=unseen.relative,
        max_abs_error=float(np.abs(unseen.error).max()),
        rmse=fitted.rms,
        held_out_rmse=unseen.rms if len(levels) >= FEWEST_SPEEDS else None,
        beta=beta,
        criterion_met=unseen.relative <= beta,
        position_range=list(surface.scaling.position),
        position_basis="fourier" if surface.scaling.periodic else "chebyshev",
        speed_range=list(surface.scaling.speed),
        speed_scale="log" if surface.scaling.logarithmic else "linear",
        sign_width=surface.sign_width,
        directional=surface.directional,
        asymmetry=gravity.asymmetry,
        temperature=celsius if np.isfinite(celsius) else None,
        positive=surface.positive.tolist(),
        negative=surface.negative.tolist(),
        covariance=surface.entry_covariance.tolist(),
        torque_constant_error=robot.joints[j].torque_constant_error,
        gravity=[
            GravityOfTrial(
                configuration=group.configuration.tolist(),
                p_xi=group.p_xi.tolist(),
                std_error=group.std_error.tolist(),
            )
            for group in gravity.groups
        ],
        speeds=levels,
        unit=robot.joints[j].unit("N m"),
    )
    name, error = robot.joints[j].name, robot.joints[j].torque_constant_error
    verdict = _verdict(name, joint, unseen, surface.scaling)
    for level in joint.speeds:
        level.std_error = float(np.hypot(level.std_error, error * level.friction))
    return joint, verdict, [*_notes(name, joint, unpaired), *_beyond_gravity(name, joint, gravity)]


def _beyond_gravity(name: str, joint: FrictionJoint, gravity: GravityFit) -> list[str]:
    """Say how large the torque over the position is that gravity does not make."""
    beyond = gravity.groups[0].beyond
    if beyond is None:
        return []
    size = float(np.std(beyond(np.linspace(*beyond.domain))))
    return [
        f"{name}: torque that depends on the position and is no gravity, {size:.3g} {joint.unit} "
        "RMS and the same both ways, as of a spring or a cable, is taken off the trials; seqid "
        "diagnose tells what it is"
    ]


def _levels(fit: Fit, fitted: Errors, unseen: Errors) -> list[SpeedLevel]:
    data = [item for own, _ in fit.parts for item in own]
    speeds = sorted({item.speed for item in data})
    scaled = fit.surface.scaling.u(np.array(speeds))
    result = []
    for speed, u in zip(speeds, scaled, strict=True):
        own = [item for item in data if item.speed == speed]
        inner = len(speeds) >= FEWEST_SPEEDS and speeds[0] < speed < speeds[-1]
        # RMS standard error of the surface over the slices of one speed, N m.
        errors = [
            fit.surface.std_error(item.q, np.full(len(item.q), item.direction * item.speed))
            for item in own
        ]
        result.append(
            SpeedLevel(
                speed=speed,
                forward=sum(item.direction > 0 for item in own),
                backward=sum(item.direction < 0 for item in own),
                friction=float(np.sqrt(np.mean(fitted.at(u).friction ** 2))),
                std_error=float(np.sqrt(np.mean(np.concatenate(errors) ** 2))),
                rmse=fitted.at(u).rms,
                left_out=unseen.at(u).rms if inner else None,
            )
        )
    return result


def _verdict(
    name: str, joint: FrictionJoint, unseen: Errors, scaling: Scaling, *, max_error: float = 0.15
) -> Verdict:
    """Good, or poor and why: the speed at which the surface is worst decides."""
    # There its error may be `max_error` of the friction.
    if joint.held_out_rmse is None:
        reason = (
            f"only {len(joint.speeds)} speed(s); with four or more one can be left out to judge"
        )
        return Verdict(joint=name, good=False, reason=reason)
    usual = float(np.sqrt(np.mean([level.friction**2 for level in joint.speeds])))
    u = scaling.u(np.array([level.speed for level in joint.speeds]))
    errors = [
        float(np.hypot(np.sqrt(np.mean(unseen.at(at).missed ** 2)), level.std_error))
        / max(level.friction, NEAR_ZERO * usual, 1e-12)
        for at, level in zip(u, joint.speeds, strict=True)
    ]
    worst = int(np.argmax(errors))
    unit = "m/s" if joint.unit == "N" else "rad/s"
    at = f"{percent(errors[worst])} at {joint.speeds[worst].speed:.3g} {unit}"
    if errors[worst] > max_error:
        reason = (
            f"friction is known to {at} only; record more or longer trials there, or look at what "
            "else moves the torque (seqid simultaneous, then seqid diagnose with its file)"
        )
        return Verdict(joint=name, good=False, reason=reason)
    overall = percent(joint.held_out_rmse / max(usual, 1e-12))
    reason = f"speeds left out are predicted to {overall} of the friction; known to {at} or better"
    return Verdict(joint=name, good=True, reason=reason)


def _notes(name: str, joint: FrictionJoint, unpaired: int) -> list[str]:
    notes = []
    if unpaired:
        notes.append(
            f"{name}: {unpaired} trial(s) have no twin in the other direction in the same "
            "configuration and were left out; Eq. 15 needs both"
        )
    if joint.directional:
        notes.append(
            f"{name}: friction depends on direction by {percent(joint.asymmetry or 0.0)}, against "
            "the assumption of Eq. 15; each direction has its own surface"
        )
    if not joint.criterion_met:
        notes.append(
            f"{name}: Eq. 11 does not hold at beta = {joint.beta:g}; at left-out speeds the "
            f"largest error is {percent(joint.max_error)} "
            f"({joint.max_abs_error:.3g} {joint.unit})"
        )
    return notes


def constants_note(robot: Robot) -> list[str]:
    """Say which joints' torque constants are taken as exact, if any."""
    exact = [
        joint.name
        for joint in robot.joints
        if joint.torque_constant is not None and joint.torque_constant_error == 0.0
    ]
    note = (
        f"torque constants taken as exact: {', '.join(exact)}; torque_constant_error in the robot "
        "file adds their error to the standard errors"
    )
    return [note] if exact else []
