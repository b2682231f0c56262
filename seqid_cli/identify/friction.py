"""Friction stage (Sec. 2.2.1-2.2.2, Eq. 7-16): one surface per joint from steady motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import QualityError
from seqid_cli.identify.friction_summary import (
    DEFAULT_BETA,
    Chosen,
    Fit,
    JointFit,
    summarise,
)
from seqid_cli.identify.gravity_of_trials import GravityFit, fit_gravity
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.ramps import without_acceleration
from seqid_cli.identify.surface_fit import (
    Orders,
    Reduced,
    SpeedData,
    choose_orders,
    fit_surface,
    information,
    left_out_errors,
    reduce_speed,
)
from seqid_cli.identify.trials import (
    Trial,
    by_joint,
    collect_trials,
    speed_levels,
)
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.params.schema import (
    FrictionStage,
    Verdict,
)
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]


class UnpairedError(QualityError):
    """A joint's trials cannot be freed of gravity."""


WIDE_RANGE = 4.0  # fastest over slowest speed from which a logarithmic scale is tried
NARROW_SIGN = 25.0  # the sign is all there at a fifth of the slowest speed
BLOCK = 8  # neighbouring slices whose errors may share a cause


def identify_friction(
    recordings: Iterable[Recording], robot: Robot, *, options: FrictionOptions
) -> FrictionStage:
    """Identify the friction surface of every joint that the logs move at constant velocity.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs with torque; one joint moves at a time, forward and backward, at several speeds.
    robot : Robot
        Chain and gravity, to remove the gravity torque by Eq. 12-15.
    options : FrictionOptions
        Orders m, l and threshold beta.

    Returns
    -------
    FrictionStage
        One surface per joint, N m, with a verdict for every joint of the robot.

    Raises
    ------
    QualityError
        If no joint moves by itself at constant velocity, or the orders ask for more speeds than
        there are.
    """
    trials = collect_trials(recordings, robot)
    if not trials:
        raise QualityError(
            "no stretch was found in which one joint moves by itself at constant velocity",
            hint="record trapezoidal moves of one joint at a time, or use seqid simultaneous",
        )
    joints, verdicts, notes = {}, [], []
    last: UnpairedError | None = None
    for j, joint in enumerate(robot.joints):
        own = by_joint(trials, j)
        if not own:
            reason = "no constant-velocity trial moves this joint"
            verdicts.append(Verdict(joint=joint.name, good=False, reason=reason))
            continue
        try:
            fit = _identify_joint(robot, j, own, options)
        except UnpairedError as error:
            verdicts.append(Verdict(joint=joint.name, good=False, reason=error.message))
            last = error
            continue
        joints[joint.name] = fit.joint
        verdicts.append(fit.verdict)
        notes += fit.notes
    if not joints and last is not None:
        raise last
    return FrictionStage(joints=joints, verdicts=verdicts, notes=notes)


def _identify_joint(
    robot: Robot, j: int, trials: list[Trial], options: FrictionOptions
) -> JointFit:
    """Fit twice: the first surface shows what acceleration is left in the trials."""
    first = _fit(robot, j, trials, options, thorough=False)
    paired = [trial for group in first.gravity.groups for trial in group.trials]
    groups = without_acceleration(robot, paired, first.surface)
    steady = [trial for group in groups for trial in group.trials]
    unpaired = first.gravity.unpaired
    second = _fit(robot, j, steady, options, thorough=True)
    return summarise(robot, j, second, unpaired, options)


def _fit(
    robot: Robot, j: int, trials: list[Trial], options: FrictionOptions, *, thorough: bool
) -> Fit:
    gravity = fit_gravity(robot, j, trials)
    if not gravity.groups:
        raise UnpairedError(
            "no pair of forward and backward trials at one speed in one configuration",
            hint="record every speed in both directions over the same range (Eq. 15)",
            where=f"joint {robot.joints[j].name}",
        )
    data = friction_data(gravity)
    scaling = _scaling(data)
    _check_orders(robot, j, data, options.velocity_order)
    chosen = _choose(data, scaling, options)
    if scaling.speed[0] * WIDE_RANGE < scaling.speed[1]:
        logarithmic = _choose(data, replace(scaling, logarithmic=True), options)
        if logarithmic[2].held_out_rmse < 0.97 * chosen[2].held_out_rmse:
            chosen = logarithmic
    data = weighted_by_level(data, chosen)
    chosen = _choose(data, chosen[0], options, thorough=thorough)
    surface = _surface(data, *chosen, directional=gravity.directional)
    return Fit(gravity, data, surface, chosen)


def weighted_by_level(data: list[SpeedData], chosen: Chosen) -> list[SpeedData]:
    """Weight each speed by the inverse variance of what the fit leaves at it."""
    _, reduced, orders = chosen
    D = fit_surface(reduced, orders.position, orders.velocity, orders.smoothing)
    left = dict.fromkeys({item.u for item in reduced}, 0.0)
    total = dict(left)
    for item in reduced:
        left[item.u] += item.misfit(D)
        total[item.u] += item.total
    variance = {u: left[u] / total[u] for u in left}
    typical = float(np.median(list(variance.values())))
    return [
        replace(item, weight=item.weight * typical / max(variance[step1.u], 0.1 * typical))
        for item, step1 in zip(data, reduced, strict=True)
    ]


def _choose(
    data: list[SpeedData], scaling: Scaling, options: FrictionOptions, *, thorough: bool = False
) -> Chosen:
    """Reduce the data on one scale and choose the orders by speeds left out (Eq. 8, 10, 11)."""
    reduced = [reduce_speed(item, scaling) for item in data]

    def accept(orders: Orders) -> bool:
        return left_out_errors(data, reduced, orders).meets(options.beta or DEFAULT_BETA)

    orders = choose_orders(
        reduced,
        position=options.position_order,
        velocity=options.velocity_order,
        accept=accept if options.beta else None,
        thorough=thorough,
    )
    return scaling, reduced, orders


def friction_data(gravity: GravityFit) -> list[SpeedData]:
    """Friction by Eq. 16, one entry per trial, all trials of a level at the level's mean speed."""
    result = []
    for group in gravity.groups:
        for trial in group.trials:
            direction = 1 if trial.velocity > 0 else -1
            friction = direction * (trial.tau - group.torque(trial.q))
            weight = np.full(len(trial.q), trial.weight)
            result.append(SpeedData(trial.speed, direction, trial.q, friction, weight))
    return _on_levels(result)


def _on_levels(data: list[SpeedData]) -> list[SpeedData]:
    result = []
    for level in speed_levels(data):
        speed = float(np.mean([item.speed for item in level]))
        result += [replace(item, speed=speed) for item in level]
    return result


def _scaling(data: list[SpeedData]) -> Scaling:
    low = min(float(item.q.min()) for item in data)
    high = max(float(item.q.max()) for item in data)
    speeds = [item.speed for item in data]
    return Scaling((low, high), (min(speeds), max(speeds)))


def _check_orders(robot: Robot, j: int, data: list[SpeedData], velocity: int | None) -> None:
    levels = len({item.speed for item in data})
    if velocity is not None and velocity + 1 > levels:
        raise QualityError(
            f"velocity order {velocity} needs at least {velocity + 1} speeds, "
            f"these logs hold {levels}",
            hint=f"record more speeds or use --velocity-order {levels - 1} or less",
            where=f"joint {robot.joints[j].name}",
        )


def _surface(
    data: list[SpeedData],
    scaling: Scaling,
    reduced: list[Reduced],
    orders: Orders,
    *,
    directional: bool,
) -> FrictionSurface:
    """Fit both directions together (Eq. 15's assumption) or each by itself."""
    sides = (1, -1) if directional else (0,)
    D, covariance = [], []
    for side in sides:
        chosen = [i for i, item in enumerate(data) if side in (0, item.direction)]
        own = [reduced[i] for i in chosen]
        D.append(fit_surface(own, orders.position, orders.velocity, orders.smoothing))
        own_data = [data[i] for i in chosen]
        covariance.append(_covariance(own_data, own, scaling, D[-1], orders.smoothing))
    size = covariance[0].shape[0]
    joined = np.zeros((len(sides) * size, len(sides) * size))
    for k, block in enumerate(covariance):
        joined[k * size : (k + 1) * size, k * size : (k + 1) * size] = block
    width = scaling.speed[0] / NARROW_SIGN
    return FrictionSurface(scaling, width, D[0], D[-1], joined, directional)


def _covariance(
    data: list[SpeedData], reduced: list[Reduced], scaling: Scaling, D: Array, smoothing: float
) -> Array:
    """Covariance of D's entries, robust against errors shared by neighbouring slices."""
    m, l = D.shape[0] - 1, D.shape[1] - 1
    normal = information(reduced, m, l, smoothing)
    bread = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    meat = np.zeros_like(bread)
    blocks = 0
    for item in data:
        A = _basis(item, scaling, m, l)
        scores = A * ((item.friction - A @ D.ravel()) * item.weight)[:, None]
        edges = np.arange(0, len(item.q), BLOCK)
        summed = np.add.reduceat(scores, edges, axis=0)
        meat += summed.T @ summed
        blocks += len(edges)
    # Few blocks per coefficient make the sandwich too small; the usual degrees-of-freedom factor.
    meat *= blocks / max(blocks - D.size, 1)
    covariance: Array = bread @ meat @ bread
    return covariance


def _basis(item: SpeedData, scaling: Scaling, m: int, l: int) -> Array:
    return scaling.basis(item.q, np.full(len(item.q), item.speed), m, l)
