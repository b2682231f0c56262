"""One rig built anew, and what its stages predict of held-out logs."""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.params.schema import Stages
from tests import Array
from tests.plants.arms.rigs import mounting
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.robots.identified import HeldOut, held_out, noise_floor, simultaneous
from tests.plants.robots.lab import Experiment
from tests.plants.simulate import Plant


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


def another(plant: Plant, rng: np.random.Generator) -> Plant:
    """Draw the friction's phases and the arrays' mountings; everything else stays."""
    friction = plant.friction
    if not isinstance(friction, SurfaceFriction):
        raise TypeError(f"friction is a {type(friction).__name__}, not a SurfaceFriction")
    imus = tuple(replace(imu, rotation=mounting(*rng.uniform(-1.2, 1.2, 3))) for imu in plant.imus)
    phase = rng.uniform(-np.pi, np.pi, friction.phase.shape)
    return replace(plant, friction=replace(friction, phase=phase), imus=imus)
