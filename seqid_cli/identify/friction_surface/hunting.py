"""Trials in which a joint hunts between counts of its encoder; see `motion.hunting`.

The torque's swing means a velocity only by the inertia that the drive feels, which the
ramps of the trials show. Where they do not, a joint hunts only if the readings stop.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.identify.friction_surface.corrections import without_acceleration
from seqid_cli.identify.friction_surface.summary import Fit
from seqid_cli.identify.friction_surface.trials import Trial, speed_levels
from seqid_cli.identify.settings import HuntingSettings
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.robot.types import Joint, Robot


def sliding_trials(
    robot: Robot,
    trials: Sequence[Trial],
    first: Fit | None,
    settings: HuntingSettings,
    *,
    min_sigma: float = 3.0,
    min_share: float = 0.3,
) -> list[Trial]:
    """Return the trials of one joint in which it slides, in their order.

    Parameters
    ----------
    robot : Robot
        The robot, of which gravity's shape is used.
    trials : sequence of Trial
        Trials of one joint.
    first : Fit, optional
        A first estimate of its friction; without it the torque tells nothing.
    settings : HuntingSettings
        By how much the velocity would swing, if friction did not damp it, from which on
        the joint stops.
    min_sigma : float
        Standard errors that the inertia must be to be known.
    min_share : float
        Share of the ramps' squared accelerations that must be none of the counts'
        making.
    """
    inertia: dict[int, float] = {}
    if first is not None:
        groups = [group.trials for group in first.gravity.groups]
        steady = without_acceleration(robot, groups, first.surface)
        for steady_group, group in zip(steady, groups, strict=True):
            share = _accelerated_share(group, first.surface)
            is_known = steady_group.inertia > min_sigma * steady_group.std_error
            if is_known and share > min_share:
                inertia |= {id(trial): steady_group.inertia / share for trial in group}
    # The inertia of a configuration that does not show it is like that of the others.
    usual = float(np.median(list(inertia.values()))) if inertia else np.inf

    def hunts(trial: Trial) -> bool:
        trial_inertia = inertia.get(id(trial), usual)
        max_swing = settings.max_speed_swing * trial_inertia * trial.speed
        return trial.stopped or trial.swing > max_swing

    return [trial for trial in trials if not hunts(trial)]


def _accelerated_share(group: Sequence[Trial], surface: FrictionSurface) -> float:
    """Return the share of the ramps' squared accelerations that is no encoder noise.

    Least squares with noise in the acceleration finds an inertia that is too small by
    this share.
    """
    low, high = surface.scaling.speed
    squares = noise = 0.0
    for trial in group:
        ramps = trial.ramps
        speed = np.abs(ramps.dq)
        ddq = ramps.ddq[(speed >= low) & (speed <= high)]
        deviation = ramps.noise * float(trial.count[trial.joint]) / np.sqrt(12.0)
        squares += ramps.weight * float(ddq @ ddq)
        noise += ramps.weight * len(ddq) * deviation**2
    return 1.0 - noise / squares if squares > 0.0 else 0.0


def note_on_hunting(
    joint: Joint, trials: Sequence[Trial], slides: Sequence[Trial]
) -> str:
    """Say at which speeds a joint hunts, what is not known then, and what helps."""
    sliding = {id(trial) for trial in slides}
    unit = joint.unit("rad/s")
    speeds: list[str] = []
    n_lost = 0
    for level in speed_levels(list(trials)):
        n_hunting = sum(id(trial) not in sliding for trial in level)
        if n_hunting:
            mean = float(np.mean([trial.speed for trial in level]))
            speeds.append(f"{mean:.3g} ({n_hunting} of {len(level)})")
            n_lost += n_hunting
    text = (
        f"{joint.name}: the joint stops and starts between counts of its encoder at"
        f" {', '.join(speeds)} {unit}: {n_lost} trial(s), whose mean torque is less"
        " than friction, were left out"
    )
    if slides:
        lowest = min(trial.speed for trial in slides)
        text += f"; below {lowest:.3g} {unit} its friction is not known"
    return f"{text}. Record faster, with a finer encoder, a softer controller or dither"
