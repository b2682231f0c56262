"""From a simulated plant to the recordings that the stages read, without files in
between.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seqid_cli.logs.recording import Recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.mechanics.rigid import PHI_NAMES
from tests.plants.motions.experiments import Trial
from tests.plants.robotfile import robot_toml
from tests.plants.robots.made import made_recording
from tests.plants.simulate import Log, Plant, simulate
from tests.unit.logs.writers import write_parquet

# seeds of one repetition's logs: stride * repetition + number of the log
SEED_STRIDE = 1000


@dataclass(frozen=True)
class Experiment:
    """One repetition: what was recorded, stage by stage,
    and what no instrument shows.
    """

    plant: Plant
    robot: Robot
    recordings: Mapping[str, Sequence[Recording]]
    logs: Mapping[str, Sequence[Log]]


def robot_of(name: str, plant: Plant) -> Robot:
    """The plant's robot file, written and read again."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        path.write_text(robot_toml(name, plant), encoding="ascii")
        return load_robot(path)


def recording_of(plant: Plant, name: str, log: Log) -> Recording:
    """What a reader makes of the log: joint torque from the current, nothing of the
    truth.
    """
    return made_recording(
        log.q,
        log.current * plant.torque_per_ampere,
        rate_hz=round(1.0 / float(log.t[1] - log.t[0]), 6),
        path=name,
        t=log.t,
        start=log.start,
        temperature=log.temperature,
        accelerometers=dict(log.accelerometers),
    )


def write_log(path: Path, plant: Plant, log: Log) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    own = {"current": log.current, "accelerometers": log.accelerometers or None}
    write_parquet(path, log.t, plant.arm.names, log.q, **own)


def run(
    name: str, plant: Plant, trials: Sequence[Trial], repetition: int, *, every: int = 1
) -> Experiment:
    """Simulate all trials anew, with the noise seeds of this repetition."""
    recordings, logs = (
        defaultdict[str, list[Recording]](list),
        defaultdict[str, list[Log]](list),
    )
    for seed, trial in enumerate(trials, start=SEED_STRIDE * (repetition + 1)):
        log = simulate(plant, trial.reference, seed, every=every, imus=trial.imus)
        label = f"{trial.stage}/{trial.name}"
        recordings[trial.stage].append(recording_of(plant, label, log))
        logs[trial.stage].append(log)
    return Experiment(plant, robot_of(name, plant), dict(recordings), dict(logs))


def true_standard(plant: Plant) -> dict[str, float]:
    """Standard parameters of all links and rotor inertias, by the names of the
    parameter file.
    """
    names = [
        f"{symbol}_{link + 1}" for link in range(plant.arm.n) for symbol in PHI_NAMES
    ]
    links = dict(zip(names, plant.arm.phi.ravel().tolist(), strict=True))
    return links | {
        f"Ia_{i + 1}": float(x) for i, x in enumerate(plant.arm.rotor_inertia)
    }


def true_value(terms: Mapping[str, float], standard: Mapping[str, float]) -> float:
    """Value that a base parameter, given as factors of standard parameters, has in the
    plant.
    """
    return sum(factor * standard[name] for name, factor in terms.items())


def true_friction(plant: Plant, joint: int, q: Array, v: Array) -> Array:
    """Friction torque (N,) N m of the plant's joint while it slides."""
    position, velocity = np.zeros((2, len(q), plant.arm.n))
    position[:, joint], velocity[:, joint] = q, v
    law = plant.friction.begin()
    return law(0.0, position, velocity, np.zeros_like(position)).sliding(velocity)[
        :, joint
    ]
