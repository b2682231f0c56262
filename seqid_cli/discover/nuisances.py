"""Nuisances: what a drive and its logger add to torque, and no effect is blamed for.

A nuisance term is a column x (N,) with a coefficient c that is known beforehand as

    tau = modelled + c x + ...,   c ~ N(mean, std^2).

Its torque stands in the base of a diagnosis, so that what it explains is not told as an
effect. `nuisances_of` is the one place that says which terms there are and how well
they are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.effects.scene import Scene
from seqid_cli.identify.nuisances import (
    PRIORS,
    FrictionChange,
    change_of,
    term_of,
    thermal_column,
)
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.params.schema import FrictionJoint, FrictionStage, Stages
from seqid_cli.typing import Array

DELAY = "delay"
THERMAL = "thermal"


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """One nuisance term of one joint, or one that several joints share.

    Attributes
    ----------
    name : str
        The quantity, `delay` for one.
    columns : mapping of joint index to sequence of (N,) arrays
        Torque [N m; N where prismatic] per unit of the coefficient, low-passed as the
        torque is, of each data set.
    std : float
        Standard deviation of the coefficient beforehand.
    mean : float
        What the parameter file says of the coefficient and its model's torque does not
        hold.
    largest : float
        Deviation from the mean above which the term is left to effects.
    """

    name: str
    columns: Mapping[int, Sequence[Array]]
    std: float
    mean: float = 0.0
    largest: float = np.inf

    @property
    def joint(self) -> int | None:
        """The joint whose term it is; None where several joints share it."""
        return next(iter(self.columns)) if len(self.columns) == 1 else None


def nuisances_of(scenes: Sequence[Scene], stages: Stages) -> list[Nuisance]:
    """Return the nuisance terms of the data sets' robot.

    Parameters
    ----------
    scenes : sequence of Scene
        One per log, with the model's torque along its motion.
    stages : Stages
        Those of the parameter file.

    Returns
    -------
    list of Nuisance
        By how much each joint's torque is later [s] against its position than the file
        says, and by how much more its friction changes per kelvin. Offset and asymmetry
        have no terms here: they are in the file's friction, which may move.
    """
    return [*_delays(scenes, stages.friction), *_thermal(scenes, stages.friction)]


def _delays(scenes: Sequence[Scene], stage: FrictionStage | None) -> list[Nuisance]:
    """Return what the delay of each joint is more than the file's."""
    # Within a sample a delay is the logger's own, another one in every session. The
    # file's may be what a stage has made of another effect: a lag that was there from
    # the start is a delay and a difference, which reads as an elasticity while the
    # delay is held. Beyond these and the file's own error it is left to effects.
    sample_s = max(scene.period for scene in scenes)
    joints_of_file = stage.joints if stage is not None else {}
    slopes = []
    for scene in scenes:
        motion = scene.motion
        # Of the torque as it is logged: it may be many samples late already.
        logged = scene.model.late(scene.modelled_filtered, motion)
        slope, _ = differentiate(logged, motion.rate_hz, motion.valid)
        slopes.append(slope)

    nuisances = []
    for joint, name in enumerate(scenes[0].robot.joint_names):
        of_file = None
        if name in joints_of_file:
            of_file = term_of(joints_of_file[name], DELAY)
        widths_s = [sample_s]
        if of_file is not None:
            widths_s += [of_file.std_error, of_file.value]
        std_s = float(np.linalg.norm(widths_s))
        nuisances.append(
            Nuisance(
                name=DELAY,
                columns={joint: [-slope[:, joint] for slope in slopes]},
                std=std_s,
                largest=std_s,
            )
        )
    return nuisances


def _thermal(scenes: Sequence[Scene], stage: FrictionStage | None) -> list[Nuisance]:
    """Return what friction changes per kelvin beyond what the file says.

    The file's model warms its friction by an estimate, which has an error. Away from
    the temperature of the trials that is an error of all friction, and no effect. What
    no log of the file has shown is left to effects.
    """
    if stage is None:
        return []
    nuisances = []
    for joint, name in enumerate(scenes[0].robot.joint_names):
        if name not in stage.joints:
            continue
        change = shown_warmth(stage.joints[name])
        if change is None:
            continue
        per_scene = [_thermal_torque(scene, joint, change) for scene in scenes]
        nuisances.append(
            Nuisance(name=THERMAL, columns={joint: per_scene}, std=change.std_error)
        )
    return nuisances


def shown_warmth(joint: FrictionJoint) -> FrictionChange | None:
    """Return how a joint's friction changes per kelvin, if its logs have shown it."""
    change = change_of(joint, THERMAL)
    if change is None or change.std_error >= PRIORS.per_kelvin:
        return None
    return change


def _thermal_torque(scene: Scene, joint: int, change: FrictionChange) -> Array:
    """Return a joint's torque (N,) N m K per unit of friction's change per kelvin."""
    motion = scene.motion
    surface = scene.model.surfaces[joint]
    if surface is None:
        return np.zeros(motion.samples)
    kelvin = np.zeros(motion.samples)
    if motion.celsius is not None:
        kelvin = surface.kelvin(motion.celsius[:, joint])
    q = motion.q[:, joint]
    v = motion.dq[:, joint]
    torque = thermal_column(surface, change, kelvin, q, v)
    return np.asarray(motion.filtered(torque[:, None], times=2)[:, 0])
