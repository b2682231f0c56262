"""What the friction stage says of one joint: the file's entry, a verdict and notes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.gravity_of_trials import GravityFit
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.surface_fit import Orders, Reduced, SpeedData, left_out_errors
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import FrictionJoint, GravityOfTrial, SpeedLevel, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent

Array = NDArray[np.float64]
Chosen = tuple[Scaling, list[Reduced], Orders]

DEFAULT_BETA = 0.05
FEWEST_SPEEDS = 4
POOR_HELD_OUT = 0.15  # left-out error over friction beyond which the surface is not to be trusted


@dataclass(frozen=True)
class Fit:
    """One joint's friction data, freed of gravity, and the surface fitted to them."""

    gravity: GravityFit
    data: list[SpeedData]
    surface: FrictionSurface
    chosen: Chosen


@dataclass(frozen=True)
class JointFit:
    """One joint's part of the stage."""

    joint: FrictionJoint
    verdict: Verdict
    notes: list[str]


def summarise(robot: Robot, j: int, fit: Fit, unpaired: int, options: FrictionOptions) -> JointFit:
    """Describe the fit of joint j; `unpaired` trials had no twin in the other direction."""
    data, surface, gravity = fit.data, fit.surface, fit.gravity
    _, reduced, orders = fit.chosen
    errors = left_out_errors(data, reduced, orders)
    beta = options.beta or DEFAULT_BETA
    rms = float(np.sqrt(np.mean(np.concatenate([item.friction for item in data]) ** 2)))
    levels = _levels(data, surface)
    joint = FrictionJoint(
        position_order=orders.position,
        velocity_order=orders.velocity,
        max_error=errors.relative,
        max_abs_error=errors.absolute,
        rmse=float(np.sqrt(np.mean([level.rmse**2 for level in levels]))),
        held_out_rmse=errors.rmse if len(levels) >= FEWEST_SPEEDS else None,
        beta=beta,
        criterion_met=errors.meets(beta),
        position_range=list(surface.scaling.position),
        speed_range=list(surface.scaling.speed),
        speed_scale="log" if surface.scaling.logarithmic else "linear",
        sign_width=surface.sign_width,
        directional=surface.directional,
        asymmetry=gravity.asymmetry,
        positive=surface.positive.tolist(),
        negative=surface.negative.tolist(),
        covariance=surface.entry_covariance.tolist(),
        gravity=[
            GravityOfTrial(
                configuration=group.configuration.tolist(),
                p_xi=group.p_xi.tolist(),
                std_error=group.std_error.tolist(),
            )
            for group in gravity.groups
        ],
        speeds=levels,
        unit="N" if robot.joints[j].prismatic else "N m",
    )
    name = robot.joints[j].name
    notes = _notes(name, joint, gravity.asymmetry, unpaired)
    return JointFit(joint, _verdict(name, joint, rms), notes)


def _levels(data: list[SpeedData], surface: FrictionSurface) -> list[SpeedLevel]:
    result = []
    for speed in sorted({item.speed for item in data}):
        own = [item for item in data if item.speed == speed]
        squares = [
            (item.friction - item.direction * surface.torque(item.q, _velocity(item))) ** 2
            for item in own
        ]
        result.append(
            SpeedLevel(
                speed=speed,
                forward=sum(item.direction > 0 for item in own),
                backward=sum(item.direction < 0 for item in own),
                rmse=float(np.sqrt(np.mean(np.concatenate(squares)))),
            )
        )
    return result


def _velocity(item: SpeedData) -> Array:
    return np.full(len(item.q), item.direction * item.speed)


def _verdict(name: str, joint: FrictionJoint, friction_rms: float) -> Verdict:
    """Good, or poor and why."""
    if joint.held_out_rmse is None:
        reason = (
            f"only {len(joint.speeds)} speed(s); with four or more one can be left out to judge"
        )
        return Verdict(joint=name, good=False, reason=reason)
    share = joint.held_out_rmse / max(friction_rms, 1e-12)
    if share > POOR_HELD_OUT:
        reason = (
            f"speeds left out are missed by {percent(share, 0)} of the friction; "
            "record more speeds, or look at what else moves the torque (seqid diagnose)"
        )
        return Verdict(joint=name, good=False, reason=reason)
    reason = f"speeds left out are predicted to {percent(share)} of the friction"
    return Verdict(joint=name, good=True, reason=reason)


def _notes(name: str, joint: FrictionJoint, asymmetry: float, unpaired: int) -> list[str]:
    notes = []
    if unpaired:
        notes.append(
            f"{name}: {unpaired} trial(s) have no twin in the other direction in the same "
            "configuration and were left out; Eq. 15 needs both"
        )
    if joint.directional:
        notes.append(
            f"{name}: friction depends on direction by {percent(asymmetry)}, against the "
            "assumption of Eq. 15; each direction has its own surface"
        )
    if not joint.criterion_met:
        notes.append(
            f"{name}: Eq. 11 does not hold at beta = {joint.beta:g}; at left-out speeds the "
            f"largest error is {percent(joint.max_error)} "
            f"({joint.max_abs_error:.3g} {joint.unit})"
        )
    return notes
