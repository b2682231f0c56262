"""The arms of the table of planted faults: the sample rigs, and drawn ones with short logs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from seqid_cli.logs.read import read_both
from seqid_cli.robot.file import load_robot
from tests.plants.arms.drawn import drawn_arm
from tests.plants.arms.rigs import mounting
from tests.plants.motions.experiments import (
    Trial,
    friction_trials,
    gravity_trials,
    imu_trials,
    inertia_trials,
    validation_trials,
)
from tests.plants.robotfile import robot_toml, urdf_text
from tests.plants.sensors import AccelerometerArray, tetrahedral_array
from tests.plants.simulate import Plant, simulate
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns
from tests.unit.inspect.planting import Columns

RATE_HZ, EVERY = 1000.0, 4


@dataclass(frozen=True)
class Bench:
    """An arm with logs by stage in a folder.

    `joint` is the one that faults are planted at, `other` the one that it is swapped with (empty
    where there is none); `weighed` says whether the URDF has inertials and gravity loads the joint.
    """

    name: str
    folder: Path
    joint: str
    other: str
    weighed: bool
    other_gravity: str  # a wrong direction, as the robot file has it
    loaded: bool = True  # whether gravity loads any joint
    keep: object = None

    @property
    def toml(self) -> str:
        """The robot file."""
        return (self.folder / "robot.toml").read_text()

    def columns(self, path: Path) -> Columns:
        """The columns of a log, whatever its format."""
        if path.suffix == ".parquet":
            return read_columns(path)
        robot = load_robot(self.folder / "robot.toml")
        recording, raw = read_both(path, robot)
        joints = raw.joints.channels
        columns = {"t": (raw.joints.stamp_ns - raw.joints.stamp_ns[0]) * 1e-9}
        for k, name in enumerate(robot.joint_names):
            columns[f"{name}.position"] = joints["position"][:, k].copy()
            columns[f"{name}.current"] = joints["current"][:, k].copy()
        for imu, values in recording.accelerometers.items():
            for k in range(values.shape[1]):
                columns[f"{imu}.a{k + 1}"] = np.interp(columns["t"], recording.t, values[:, k])
        return columns


def sample(rig: str, joint: str, other: str, *, weighed: bool, loaded: bool = True) -> Bench:
    """One of the sample rigs."""
    gravity = "0.0, 0.0, 9.81" if weighed else "9.81, 0.0, 0.0"
    return Bench(rig, SAMPLES / rig, joint, other, weighed, gravity, loaded)


def drawn(seed: int) -> Bench:
    """A drawn arm with a URDF, recorded for every stage."""
    plant = _with_imu(drawn_arm(seed))
    keep = tempfile.TemporaryDirectory()
    folder = Path(keep.name)
    (folder / "arm.urdf").write_text(urdf_text("drawn", plant))
    (folder / "robot.toml").write_text(robot_toml("drawn", plant, urdf="arm.urdf"))
    for number, trial in enumerate(_trials(plant, seed)):
        log = simulate(plant, trial.reference, 100 * seed + number, every=EVERY, imus=trial.imus)
        columns = {"t": log.t}
        for k, name in enumerate(plant.arm.names):
            columns[f"{name}.position"] = log.q[:, k]
            columns[f"{name}.current"] = log.current[:, k]
        for imu, values in log.accelerometers.items():
            for k in range(values.shape[1]):
                columns[f"{imu}.a{k + 1}"] = values[:, k]
        (folder / trial.stage).mkdir(exist_ok=True)
        write_columns(folder / trial.stage / f"{trial.name}.parquet", columns)
    joint, other = _heaviest(plant)
    down = plant.arm.gravity
    turned = ", ".join(repr(float(x)) for x in np.roll(down, 1))
    names = plant.arm.names
    return Bench(f"drawn {seed}", folder, names[joint], names[other], True, turned, True, keep)


def _with_imu(plant: Plant) -> Plant:
    positions, axes = tetrahedral_array(0.05)
    last = plant.arm.n - 1
    turn = mounting(0.3, -0.5, 0.8)
    lever = np.array([0.02, -0.01, 0.03])
    imu = AccelerometerArray("imu_a", last, positions, axes, turn, lever, bias=0.02)
    return replace(plant, imus=(imu,))


def _heaviest(plant: Plant) -> tuple[int, int]:
    """The joint that carries most, and the one that carries least of the others."""
    from tests.plants.arms.drawn import _loads

    load = _loads(plant.arm, plant.position_limits).gravity
    order = np.argsort(load)
    return int(order[-1]), int(order[0])


def _trials(plant: Plant, seed: int) -> list[Trial]:
    rng = np.random.default_rng([seed, 5])
    low, high = plant.position_limits.T
    postures = [rng.uniform(0.5 * low, 0.5 * high) for _ in range(4)]
    return [
        *friction_trials(plant, postures[:1], rate_hz=RATE_HZ, speeds=5, lowest=0.2),
        *gravity_trials(plant, postures[:2], rate_hz=RATE_HZ, speeds=(0.5,)),
        *imu_trials(plant, postures, rate_hz=RATE_HZ, turns=1),
        *inertia_trials(plant, postures, rng, seconds=4.0, rate_hz=RATE_HZ),
        *validation_trials(plant, rng, runs=1, seconds=8.0, points=3, rate_hz=RATE_HZ),
    ]


ARMS: tuple[Callable[[], Bench], ...] = (
    partial(sample, "one_joint", "joint_1", "", weighed=False),
    partial(sample, "two_joint", "joint_2", "joint_1", weighed=False, loaded=False),
    partial(sample, "six_joint", "elbow", "wrist_1", weighed=True),
    partial(drawn, 4),
    partial(drawn, 12),
    partial(drawn, 23),
    partial(drawn, 31),
)
