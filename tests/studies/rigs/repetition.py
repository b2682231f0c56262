"""One rig built anew: its logs, its stages, and what they predict of held-out logs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.params.schema import Stages
from tests.plants.robots.identified import HeldOut, held_out, noise_floor, simultaneous
from tests.plants.robots.lab import Experiment

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Predicted:
    """Errors on held-out logs step by step and in one step; `floor` (n,) N m is the noise alone."""

    sequential: HeldOut
    simultaneous: HeldOut
    floor: Array


def predicted(experiment: Experiment, stages: Stages) -> Predicted:
    """Predict the held-out logs with the stages, and with the classical fit of the same logs."""
    logs, robot, options = experiment.recordings, experiment.robot, InertiaOptions()
    own = held_out(logs["validation"], robot, stages, options)
    training = [log for stage in ("friction", "gravity", "inertia") for log in logs.get(stage, ())]
    classical = simultaneous(training, robot, stages.imu)
    together = held_out(logs["validation"], robot, classical, options)
    return Predicted(own, together, noise_floor(experiment, "validation", own.cutoff_hz))
