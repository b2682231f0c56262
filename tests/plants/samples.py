"""Make the sample logs: `python -m tests.plants.samples OUTDIR [one_joint two_joint
six_joint]`.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.parquet as pq

from tests.plants.arms.rigs import one_joint, six_joint, two_joint
from tests.plants.effects.registry import Injection, inject
from tests.plants.friction.laws import Extra
from tests.plants.motions import experiments
from tests.plants.motions.experiments import Trial
from tests.plants.motions.trials import PERIODS, moves, waves, zigzags
from tests.plants.robotfile import robot_toml, urdf_text
from tests.plants.robots.lab import true_friction, true_standard, write_log
from tests.plants.simulate import Log, Plant, simulate
from tests.unit.logs.writers import write_mcap

Encoding = Literal["cdr", "json"]
SEED = 20260101
T0_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z


@dataclass(frozen=True)
class Recipe:
    plant: Plant
    trials: Sequence[Trial]
    change: Injection
    changed: Sequence[Trial]
    changed_every: int
    every: int
    formats: Mapping[str, Encoding]
    urdf: str | None = None
    base: Mapping[str, float] = field(default_factory=dict)


def changed_trials(
    plant: Plant, seed: int, *, seconds: float, imus: bool
) -> list[Trial]:
    """All joints at 80 % of their speeds:
    two logs to learn from and one to hold out.
    """
    rng = np.random.default_rng([seed, 1])
    made = {
        "fourier": waves(plant, rng, period=PERIODS[0], share=0.8, seconds=seconds),
        "trapezoids": zigzags(plant, rng, share=0.8, seconds=seconds),
        "held_out": moves(plant, rng, share=0.8, seconds=seconds),
    }
    return [Trial("changed", name, motion, imus=imus) for name, motion in made.items()]


def one_joint_trials(plant: Plant, rng: np.random.Generator) -> list[Trial]:
    home = [np.zeros(1)]
    return [
        *experiments.friction_trials(plant, home[0]),
        *experiments.gravity_trials(plant, home, speeds=(0.1, 0.2)),
        *experiments.imu_trials(plant, home),
        *experiments.inertia_trials(plant, home, rng, seconds=12.0),
        *experiments.validation_trials(plant, rng, seconds=12.0),
    ]


def one_joint_recipe() -> Recipe:
    """Sec. 4.1 at 1 kHz, all Parquet; then a hose pulls at the link."""
    plant = one_joint()
    trials = one_joint_trials(plant, np.random.default_rng(SEED))
    base = {
        "mx_1": float(plant.arm.phi[0, 1]),
        "my_1": 0.0,
        "Izz_1": float(plant.arm.phi[0, 9]),
    }
    later = changed_trials(plant, SEED, seconds=35.0, imus=True)
    return Recipe(plant, trials, inject("spring", plant, 0), later, 4, 1, {}, base=base)


def two_joint_trials(
    plant: Plant, rng: np.random.Generator, *, inertia_s: float = 8.0
) -> list[Trial]:
    """All logs of the planar rig, two of them of `inertia_s` seconds for inertia.

    There is no gravity to identify.
    """
    postures = [np.array([0.0, angle]) for angle in (0.0, 1.2, -0.9, 2.3, -1.9)]
    return [
        *experiments.friction_trials(plant, postures[0]),
        *experiments.imu_trials(plant, postures, turns=1),
        *experiments.inertia_trials(
            plant, postures[1:], rng, pairs=[(0, 1), (0, 1)], seconds=inertia_s
        ),
        *experiments.validation_trials(plant, rng, seconds=12.0, points=6),
    ]


def two_joint_recipe() -> Recipe:
    """Sec. 4.2 at 250 Hz, the IMU rotations as JSON MCAP; then the elbow's gear has
    worn.
    """
    plant = two_joint()
    trials = two_joint_trials(plant, np.random.default_rng(SEED + 1))
    phi, length = plant.arm.phi, float(plant.arm.dh[1, 1])
    pi_1 = phi[0, 9] + plant.arm.reflected[0] + phi[1, 0] * length**2
    values = (pi_1, phi[1, 9], plant.arm.reflected[1], phi[1, 1], phi[1, 2])
    base = {f"pi_{k}": float(value) for k, value in enumerate(values, start=1)}
    later = changed_trials(plant, SEED + 1, seconds=35.0, imus=True)
    change = inject("load_dependent_friction", plant, 1)
    return Recipe(plant, trials, change, later, 8, 4, {"imu": "json"}, base=base)


SIX_POSTURES = np.array(
    [
        [0.0, -1.2, 0.9, -0.6, 0.7, 0.0],
        [0.4, -0.7, 1.6, 0.9, -1.2, 1.1],
        [-0.5, -1.7, -1.1, 1.7, 1.5, -1.4],
        [0.9, -0.3, -0.6, -1.8, 0.3, 2.1],
        [-1.0, -2.1, 1.9, 0.2, -0.5, -2.2],
        [0.2, -1.5, 0.2, 2.3, 2.0, 0.6],
    ]
)


def six_joint_trials(plant: Plant, rng: np.random.Generator) -> list[Trial]:
    postures = list(SIX_POSTURES)
    return [
        *experiments.friction_trials(plant, postures[0], lowest=0.08),
        *experiments.gravity_trials(plant, postures[:5], speeds=(0.3,)),
        *experiments.imu_trials(plant, postures, turns=2),
        *experiments.inertia_trials(plant, postures, rng, seconds=5.0),
        *experiments.validation_trials(plant, rng, seconds=15.0, points=6),
    ]


def six_joint_recipe() -> Recipe:
    """Build the UR5e-sized arm's logs at 250 Hz; some two-joint moves as CDR MCAP."""
    plant = six_joint()
    trials = six_joint_trials(plant, np.random.default_rng(SEED + 2))
    shoulder = [
        f"inertia/{trial.name}" for trial in trials if trial.stage == "inertia"
    ][:3]
    later = changed_trials(plant, SEED + 2, seconds=27.0, imus=False)
    change = inject("spring", plant, 2)
    formats: dict[str, Encoding] = dict.fromkeys(shoulder, "cdr")
    return Recipe(plant, trials, change, later, 4, 4, formats, urdf="six_joint.urdf")


RECIPES: Mapping[str, Callable[[], Recipe]] = {
    make.__name__.removesuffix("_recipe"): make
    for make in (one_joint_recipe, two_joint_recipe, six_joint_recipe)
}


def truth_document(name: str, recipe: Recipe) -> dict[str, object]:
    """Everything that the plant has and its logs do not say."""
    plant, arm, change = recipe.plant, recipe.plant.arm, recipe.change
    extra, hidden = change.plant.friction, change.plant.hidden.torques
    law = vars(extra.curve if isinstance(extra, Extra) else hidden[-1])
    joint = None if change.joint is None else arm.names[change.joint]
    rotors = {f"Ia_{i + 1}": float(arm.rotor_inertia[i]) for i in range(arm.n)}
    amperes = np.sqrt(
        plant.current_noise**2 + np.asarray(plant.current_step) ** 2 / 12.0
    )
    torque_noise = (amperes * plant.torque_per_ampere).tolist()
    return {
        "robot": name,
        "joints": list(arm.names),
        "parameters": {
            k: x for k, x in true_standard(plant).items() if k not in rotors
        },
        "rotor_inertia": rotors,
        "base_parameters": dict(recipe.base),
        "rotor_coupling": "full" if arm.rotor_coupling else "diagonal",
        "torque_noise_std": dict(zip(arm.names, torque_noise, strict=True)),
        "friction": {
            joint: friction_table(plant, i) for i, joint in enumerate(arm.names)
        },
        "imus": {
            imu.name: {
                "after_joint": arm.names[imu.after],
                "R_link_from_imu": imu.rotation.tolist(),
                "lever": imu.lever.tolist(),
                "noise_std": imu.noise,
                "bias_std": imu.bias,
            }
            for imu in plant.imus
        },
        "changed": {"effect": change.kind, "joint": None} | law | {"joint": joint},
    }


def friction_table(plant: Plant, joint: int) -> dict[str, object]:
    """Friction torque of one joint on a grid: rows are positions, columns velocities, N
    m.
    """
    (low, high), top = plant.position_limits[joint], float(plant.velocity_limits[joint])
    positions, speeds = np.linspace(low, high, 25), np.geomspace(0.02 * top, top, 12)
    velocities = np.concatenate([-speeds[::-1], speeds])
    q, v = (x.ravel() for x in np.meshgrid(positions, velocities, indexing="ij"))
    table = np.round(true_friction(plant, joint, q, v).reshape(len(positions), -1), 9)
    grid = {"position": positions.tolist(), "velocity": velocities.tolist()}
    return grid | {"torque": table.tolist()}


def save(folder: Path, recipe: Recipe, trial: Trial, log: Log) -> None:
    plant, path = recipe.plant, folder / trial.stage / f"{trial.name}.parquet"
    encoding = recipe.formats.get(
        f"{trial.stage}/{trial.name}", recipe.formats.get(trial.stage)
    )
    if encoding is None:
        write_log(path, plant, log)
        return pack(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    own = (path.with_suffix(".mcap"), log.t, plant.arm.names, log.q)
    arrays = log.accelerometers or None
    write_mcap(
        *own, encoding=encoding, effort=log.current, accelerometers=arrays, t0_ns=T0_NS
    )


def pack(path: Path) -> None:
    """Write a Parquet file again, smaller: many values as byte streams, few in a
    dictionary.
    """
    table = pq.read_table(path)
    many = [x for x in table.column_names if len(table[x].unique()) > len(table) / 8]
    few = [x for x in table.column_names if x not in many]
    how = {
        "use_dictionary": few,
        "column_encoding": dict.fromkeys(many, "BYTE_STREAM_SPLIT"),
    }
    pq.write_table(table, path, compression="zstd", compression_level=9, **how)


def make(outdir: Path, name: str) -> None:
    recipe, folder = RECIPES[name](), outdir / name
    folder.mkdir(parents=True, exist_ok=True)
    text = robot_toml(name, recipe.plant, urdf=recipe.urdf)
    (folder / "robot.toml").write_text(text, encoding="ascii")
    if recipe.urdf is not None:
        (folder / recipe.urdf).write_text(
            urdf_text(name, recipe.plant), encoding="ascii"
        )
    document = json.dumps(truth_document(name, recipe)) + "\n"
    (folder / "truth.json").write_text(document, encoding="ascii")
    parts = (
        (SEED + 1000, recipe.plant, recipe.trials, recipe.every),
        (SEED + 2000, recipe.change.plant, recipe.changed, recipe.changed_every),
    )
    for first, plant, trials, every in parts:
        for seed, trial in enumerate(trials, start=first):
            log = simulate(plant, trial.reference, seed, every=every, imus=trial.imus)
            save(folder, recipe, trial, log)


if __name__ == "__main__":
    outdir, *names = sys.argv[1:]
    for name in names or RECIPES:
        make(Path(outdir), name)
