"""An arm of a UR5e's size: held-out torque, honesty of the standard errors, IMU mountings."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.params.schema import ImuStage, Parameter, Stages
from tests import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.motions.experiments import (
    Trial,
    friction_trials,
    gravity_trials,
    imu_trials,
    inertia_trials,
    validation_trials,
)
from tests.plants.robots.identified import sequential
from tests.plants.robots.lab import run, true_standard, true_value
from tests.plants.samples import SIX_POSTURES
from tests.plants.simulate import Plant
from tests.studies.rigs.repetition import Predicted, another, predicted
from tests.studies.tables import number, rms, share_within, table

SEED, REPETITIONS = 43, 3
EVERY = 4  # control periods per recorded row: 250 Hz


@dataclass(frozen=True)
class Mounting:
    """Error of one IMU's mounting about the link's axes (3,) deg, and the reported one."""

    error: Array
    std_error: Array


@dataclass(frozen=True)
class Repetition:
    """Results of one arm built anew."""

    torque: Predicted
    z: dict[str, list[float]]  # by stage
    rank: str
    imus: dict[str, Mounting]


def trials(plant: Plant, rng: np.random.Generator) -> list[Trial]:
    """All logs of one repetition, as in the sample logs."""
    postures = list(SIX_POSTURES)
    return [
        *friction_trials(plant, postures[:1], lowest=0.08),
        *gravity_trials(plant, postures[:5], speeds=(0.3,)),
        *imu_trials(plant, postures, turns=2),
        *inertia_trials(plant, postures, rng, seconds=5.0),
        *validation_trials(plant, rng, runs=1, seconds=15.0, points=6),
    ]


def repetition(number_of: int) -> Repetition:
    """Build the arm, record, identify, predict."""
    rng = np.random.default_rng([SEED, number_of])
    plant = another(six_joint(), rng)
    experiment = run("six_joint", plant, trials(plant, rng), SEED + number_of, every=EVERY)
    stages = sequential(experiment.recordings, experiment.robot)
    assert stages.imu is not None
    return Repetition(
        torque=predicted(experiment, stages),
        z=deviations(plant, stages),
        rank=f"{stages.inertia.rank} of {stages.inertia.structural_rank}",
        imus=mountings(plant, stages.imu),
    )


def deviations(plant: Plant, stages: Stages) -> dict[str, list[float]]:
    """Errors over standard errors of every base parameter, by stage."""
    standard = true_standard(plant)

    def z(parameters: Sequence[Parameter]) -> list[float]:
        return [(p.value - true_value(p.terms, standard)) / p.std_error for p in parameters]

    found = {"gravity": stages.gravity, "inertia": stages.inertia}
    return {name: z(stage.parameters) for name, stage in found.items() if stage is not None}


def mountings(plant: Plant, stage: ImuStage) -> dict[str, Mounting]:
    """Errors of the mounting rotations as small rotations about the link's axes."""
    result = {}
    for imu in plant.imus:
        found = stage.imus[imu.name]
        off = Rotation.from_matrix(np.array(found.rotation) @ imu.rotation.T)
        result[imu.name] = Mounting(
            np.degrees(off.as_rotvec()), np.array(found.std_errors_deg, dtype=np.float64)
        )
    return result


def study(chosen: Namespace) -> str:
    """All tables of this arm; there is no quick way to them."""
    del chosen
    found = [repetition(k) for k in range(REPETITIONS)]
    ranks = ", ".join(sorted({r.rank for r in found}))
    return "\n\n".join(
        [
            f"{REPETITIONS} arms; rank of the inertia stage {ranks}.",
            torque_table(found),
            honesty_table(found),
            imu_table(found),
        ]
    )


def torque_table(found: list[Repetition]) -> str:
    """RMSE per joint on held-out moves, N m, RMS over the repetitions."""
    columns = {
        "sequential": [r.torque.sequential.every for r in found],
        "simultaneous": [r.torque.simultaneous.every for r in found],
        "current noise alone": [r.torque.floor for r in found],
        "sequential, sliding": [r.torque.sequential.sliding for r in found],
        "simultaneous, sliding": [r.torque.simultaneous.sliding for r in found],
    }
    rows = [
        [name, *(number(rms(joint), 3) for joint in np.array(values).T)]
        for name, values in columns.items()
    ]
    return table(["held-out torque RMSE, N m", *six_joint().arm.names], rows)


def honesty_table(found: list[Repetition]) -> str:
    """How often the truth lies within the standard errors."""
    rows = []
    for stage in found[0].z:
        z = [value for r in found for value in r.z[stage]]
        shares = [f"{100 * share_within(z, limit):.0f} %" for limit in (2.0, 3.0)]
        rows.append([stage, str(len(found[0].z[stage])), *shares, number(rms(z))])
    header = ["base parameters", "count", "within 2 standard errors", "within 3", "rms z"]
    return table(header, rows)


def imu_table(found: list[Repetition]) -> str:
    """Mounting errors next to the reported standard errors."""
    rows = []
    for name in found[0].imus:
        mounted = [r.imus[name] for r in found]
        error = np.array([m.error for m in mounted])
        expected = np.array([m.std_error for m in mounted])
        worst = float(np.linalg.norm(error, axis=1).max())
        cells = [rms(error), rms(expected), worst, rms(error / expected)]
        rows.append([name, *(number(c) for c in cells)])
    header = ["IMU mounting", "rms error per axis, deg", "reported std error, deg"]
    return table([*header, "largest error angle, deg", "rms z"], rows)
