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
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.params.schema import Stages
from seqid_cli.typing import Array

DELAY = "delay"


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
        What the delay [s] of each joint's torque against its position is more than the
        file's. Offset and asymmetry have no terms here: they are in the file's
        friction, which may move.
    """
    # Within a sample a delay is the logger's own, another one in every session. The
    # file's may be what a stage has made of another effect: a lag that was there from
    # the start is a delay and a difference, which reads as an elasticity while the
    # delay is held. Beyond these and the file's own error it is left to effects.
    sample_s = max(scene.period for scene in scenes)
    joints_of_file = stages.friction.joints if stages.friction else {}
    slopes = []
    for scene in scenes:
        motion = scene.motion
        # Of the torque as it is logged: it may be many samples late already.
        logged = scene.model.late(scene.modelled_filtered, motion)
        slope, _ = differentiate(logged, motion.rate_hz, motion.valid)
        slopes.append(slope)

    nuisances = []
    for joint, name in enumerate(scenes[0].robot.joint_names):
        terms = joints_of_file[name].nuisances if name in joints_of_file else []
        of_file = next((term for term in terms if term.name == DELAY), None)
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
