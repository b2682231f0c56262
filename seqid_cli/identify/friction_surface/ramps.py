"""Acceleration that is left in trials of constant velocity: its torque and that torque's error.

A controller never holds a speed exactly. With one joint moving, the torque of its acceleration is
d_kk ddq (Eq. 25), d_kk being one number per configuration of the other joints. The ramps up to the
speed and back down determine it: over windows of them and over the slices of the trial itself,

    tau - f(q, dq) = a(q)' p_xi + d_kk ddq,

with friction f as far as it is known and gravity as in Eq. 12. Friction that is not quite right
adds to d_kk in one ramp what it takes off in the other. Where nothing determines d_kk it is taken
as zero, and as uncertain by what the other configurations show. Where they show nothing either, its
error (`inertia_error`) is so large that all torque of the trials may be acceleration's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.friction_surface.gravity_separation import Clustered, gravity_columns
from seqid_cli.identify.friction_surface.trials import Trial, configurations
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.robot.types import Robot
from seqid_cli.robust import PER_MEDIAN


@dataclass(frozen=True)
class SteadyGroup:
    """Trials of one joint in one configuration, with the torque of acceleration taken off.

    `inertia` and `std_error` are d_kk, kg m^2 (kg where prismatic), as it was used.
    """

    trials: list[Trial]
    inertia: float
    std_error: float


def without_acceleration(
    robot: Robot, trials: Sequence[Trial], surface: FrictionSurface
) -> list[SteadyGroup]:
    """Take the torque of what acceleration is left (Eq. 25) off the trials of one joint.

    What friction differs by because the speed is not quite constant is taken off as well, so that
    the trial is one at its mean velocity.

    `surface`: friction of the joint, if only a first estimate. Returns: one per configuration.
    """
    groups = configurations(list(trials))
    found = [_inertia_of(robot, group, surface) for group in groups]
    known = np.array([one for one in found if one is not None]).reshape(-1, 4)
    value, white, robust, count = known.T
    usual = float(np.sqrt(np.mean(value**2))) if len(known) else 0.0
    # How many times the variance is that of white noise, by all configurations: few trials by
    # themselves do not show what they share.
    inflation = max(float(count @ robust / (count @ white)), 1.0) if (white > 0).any() else 1.0
    result = []
    for group, own in zip(groups, found, strict=True):
        inertia = 0.0 if own is None else max(own[0], 0.0)
        error = usual if own is None else float(np.sqrt(max(own[2], own[1] * inflation)))
        largest = error
        if not len(known):  # all torque of the trials could be acceleration's
            torque = max(float(np.median(np.abs(trial.tau))) for trial in group)
            accelerated = max(float(np.sqrt(np.mean(trial.ddq**2))) for trial in group)
            largest = torque / accelerated if accelerated > 0.0 else 0.0
        steady = [replace(_steady(t, inertia, surface), inertia_error=largest) for t in group]
        result.append(SteadyGroup(steady, inertia, error))
    return result


def _steady(
    trial: Trial, inertia: float, surface: FrictionSurface, *, max_ratio: float = 2.0
) -> Trial:
    """The trial at its mean velocity, without the slices of more than noise and usual push."""
    # At the ends a controller settles faster than the path follows: what is taken off is as wrong
    # there as it is large.
    mean, pushed = np.full(len(trial.q), trial.velocity), inertia * trial.ddq
    off = pushed + surface.torque(trial.q, trial.dq) - surface.torque(trial.q, mean)
    tau = trial.tau - off
    noise = PER_MEDIAN * float(np.median(np.abs(np.diff(tau, 2)))) / np.sqrt(6.0)
    kept = np.abs(pushed) <= max_ratio * np.hypot(noise, float(np.median(np.abs(pushed))))
    steady = {name: getattr(trial, name)[kept] for name in ("q", "dq", "ddq", "t", "places")}
    return replace(trial, tau=tau[kept], **steady)


def _inertia_of(
    robot: Robot, group: list[Trial], surface: FrictionSurface, *, min_windows: int = 6
) -> tuple[float, float, float, int] | None:
    """d_kk of one configuration, None where its ramps do not determine it.

    Its variance for white noise follows, that robust within trials, and the number of these.
    """
    low, high = surface.scaling.speed
    rows, right, cluster, windows = [], [], [], 0
    for number, trial in enumerate(group):
        # Windows at speeds at which friction was seen; the others hold a reversal or a rest.
        ramps, speed = trial.ramps, np.abs(trial.ramps.dq)
        kept = (speed >= low) & (speed <= high)
        windows += int(kept.sum())
        for part, own in ((trial, slice(None)), (ramps, kept)):
            q, root = part.q[own], np.sqrt(part.weight)
            a = gravity_columns(robot, trial.joint, group[0].configuration, q)
            rows.append(np.column_stack([part.ddq[own], a]) * root)
            right.append((part.tau[own] - surface.torque(q, part.dq[own])) * root)
            cluster.append(np.full(len(q), number))
    if windows < min_windows:
        return None
    found = Clustered.of(np.vstack(rows), np.concatenate(right), np.concatenate(cluster))
    count, spare = len(found.moves), len(found.left) - len(found.theta)
    robust = count / max(count - 1, 1) * float(np.sum(found.moves[:, 0] ** 2))
    white = float(found.left @ found.left) / max(spare, 1) * float(found.bread[0, 0])
    return float(found.theta[0]), white, robust, count
