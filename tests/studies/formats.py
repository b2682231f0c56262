"""The same motion as Parquet, MCAP with CDR and MCAP with JSON: do the parameters agree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seqid_cli.logs.read import read_recordings
from seqid_cli.robot.types import Robot
from tests.plants.experiments import friction_trials, imu_trials, inertia_trials
from tests.plants.rigs import two_joint
from tests.plants.robots.identified import sequential
from tests.plants.robots.lab import Experiment, run
from tests.plants.samples import T0_NS
from tests.plants.simulate import Log, Plant
from tests.studies.tables import table
from tests.studies.two_joint import POSTURES
from tests.unit.logs.writers import write_mcap, write_parquet

SEED = 44
EVERY = 4
FORMATS = {"Parquet": "parquet", "MCAP, CDR": "cdr", "MCAP, JSON": "json"}


def written(folder: Path, plant: Plant, label: str, log: Log, form: str) -> Path:
    """Write one log."""
    joints, arrays = plant.arm.names, log.accelerometers or None
    if form == "parquet":
        path = folder / f"{label}.parquet"
        return write_parquet(path, log.t, joints, log.q, current=log.current, accelerometers=arrays)
    return write_mcap(
        folder / f"{label}.mcap",
        log.t,
        joints,
        log.q,
        encoding="cdr" if form == "cdr" else "json",
        effort=log.current,
        accelerometers=arrays,
        t0_ns=T0_NS,
    )


def read_back(experiment: Experiment, form: str, robot: Robot) -> Experiment:
    """The experiment with its recordings read from files of one format."""
    recordings = {}
    with TemporaryDirectory() as name:
        for stage, logs in experiment.logs.items():
            folder = Path(name) / stage
            folder.mkdir()
            paths = [
                written(folder, experiment.plant, f"log_{k}", log, form)
                for k, log in enumerate(logs)
            ]
            recordings[stage] = list(read_recordings(paths, robot))
    return Experiment(experiment.plant, robot, recordings, experiment.logs)


def values(experiment: Experiment) -> dict[str, list[float]]:
    """All identified numbers, by group."""
    stages = sequential(experiment)
    assert stages.friction is not None
    assert stages.inertia is not None
    assert stages.imu is not None
    surfaces = [np.ravel(j.positive) for j in stages.friction.joints.values()]
    mounted = [np.ravel(i.rotation) for i in stages.imu.imus.values()]
    return {
        "friction": np.concatenate(surfaces).tolist(),
        "IMU rotations": np.concatenate(mounted).tolist(),
        "inertia": [p.value for p in stages.inertia.parameters],
        "standard errors": [p.std_error for p in stages.inertia.parameters],
    }


def largest_difference(one: Sequence[float], other: Sequence[float]) -> float:
    """Largest difference, relative to each value; infinite where the numbers do not pair up."""
    if len(one) != len(other):
        return float("inf")
    a, b = np.array(one), np.array(other)
    size = np.maximum(np.abs(a), np.abs(b))
    return float(np.max(np.abs(a - b) / np.where(size > 0, size, 1.0), initial=0.0))


def study(speeds: int = 12) -> str:
    """Largest relative difference of every group of parameters from those of Parquet."""
    plant, rng = two_joint(), np.random.default_rng(SEED)
    trials = [
        *friction_trials(plant, POSTURES[:1], speeds=speeds, lowest=0.1),
        *imu_trials(plant, POSTURES[:2], turns=1),
        *inertia_trials(plant, POSTURES[1:], rng, pairs=[(0, 1)], seconds=5.0),
    ]
    experiment = run("two_joint", plant, trials, SEED, every=EVERY)
    found = {
        label: values(read_back(experiment, form, experiment.robot))
        for label, form in FORMATS.items()
    }
    reference = found["Parquet"]
    rows = [
        [label, *(f"{largest_difference(reference[g], other[g]):.1e}" for g in reference)]
        for label, other in found.items()
        if label != "Parquet"
    ]
    return table(["largest relative difference from Parquet", *reference], rows)
