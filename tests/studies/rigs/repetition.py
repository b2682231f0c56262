"""One rig built anew, what its stages predict of held-out logs, and what repetitions
say.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.params.schema import Stages
from tests import Array
from tests.plants.arms.rigs import mounting
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.robots.identified import held_out, noise_floor, simultaneous
from tests.plants.robots.lab import Experiment
from tests.plants.simulate import Plant
from tests.studies.tables import number, rms, table

METHODS = ("sequential", "simultaneous", "current noise alone")


@dataclass(frozen=True)
class Estimate:
    """Error and standard error of a quantity, as shares of a true value."""

    error: float
    std_error: float


# RMSE (n,) N m of all samples, of sliding ones
Torque = Mapping[str, tuple[Array, Array]]


def predicted(experiment: Experiment, stages: Stages) -> Torque:
    """Predict held-out logs: with the stages, with the classical fit of the same logs,
    noise.
    """
    logs, robot, options = experiment.recordings, experiment.robot, InertiaOptions()
    training = [
        log
        for stage in ("friction", "gravity", "inertia")
        for log in logs.get(stage, ())
    ]
    classical = simultaneous(training, robot, stages.imu)
    own, other = (
        held_out(logs["validation"], robot, x, options) for x in (stages, classical)
    )
    floor = noise_floor(experiment, "validation", own.cutoff_hz)
    found = ((own.every, own.sliding), (other.every, other.sliding), (floor, floor))
    return dict(zip(METHODS, found, strict=True))


def another(plant: Plant, rng: np.random.Generator) -> Plant:
    """Draw the friction's phases and the arrays' mountings; everything else stays."""
    friction = surface_of(plant)
    imus = tuple(
        replace(imu, rotation=mounting(*rng.uniform(-1.2, 1.2, 3)))
        for imu in plant.imus
    )
    phase = rng.uniform(-np.pi, np.pi, friction.phase.shape)
    return replace(plant, friction=replace(friction, phase=phase), imus=imus)


def surface_of(plant: Plant) -> SurfaceFriction:
    """Friction of a plant whose friction has a known form."""
    assert isinstance(plant.friction, SurfaceFriction)
    return plant.friction


def error_table(rows: Mapping[str, tuple[Sequence[Estimate], str]]) -> str:
    lines = []
    for label, (found, paper) in rows.items():
        errors = 100 * np.array([e.error for e in found])
        z = rms([e.error / e.std_error for e in found])
        sizes = np.median(np.abs(errors)), np.abs(errors).max(), errors.mean(), z
        lines.append([label, *map(number, sizes), paper])
    return table(
        [
            "parameter",
            "median error %",
            "worst %",
            "mean (signed) %",
            "rms z",
            "paper %",
        ],
        lines,
    )
