"""Parameter files whose logs are on disk: a model with effects, and the torque that it
makes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.effects.fitted import FittedEffect, as_stage
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.export.motions import FullModel
from seqid_cli.logs.storage.files import sha256_of
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import (
    SCHEMA,
    ClosedLoop,
    InputLog,
    JointRmse,
    ParameterFile,
    Stages,
)
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.sample import SAMPLES
from tests.unit.export.arms import sample
from tests.unit.logs.writers import write_parquet

RATE_HZ, CUTOFF_HZ, SECONDS = 100.0, 5.0, 40.0
NOISE = 0.02  # N m, of the measured torque, white
Effect = tuple[str, int, dict[str, float], list[float]]
DRAG: Effect = ("nonlinear_viscous", 0, {"exponent": 2.0}, [0.6])


@dataclass(frozen=True, kw_only=True)
class Logged:
    """A folder with `refined.json` and its logs; `other` is a log that the file does
    not name.
    """

    folder: Path
    robot: Path
    file: Path
    other: Path

    @property
    def training(self) -> Path:
        return self.folder / "training.parquet"

    @property
    def held_out(self) -> Path:
        return self.folder / "held_out.parquet"


def logged(
    folder: Path, rig: str, effects: Sequence[Effect] = (), *, seed: int = 0
) -> Logged:
    """Write a model, its training log, its held-out one,
    and one that it does not name.
    """
    robot, stages = sample(rig)
    stages.inertia.cutoff_hz = CUTOFF_HZ
    stages.inertia.rmse = dict.fromkeys(robot.joint_names, NOISE)
    stages.effects = [
        as_stage(
            FittedEffect(
                effect=CATALOGUE[name],
                joint=joint,
                settings=settings,
                coefficients=np.array(c),
                covariance=np.eye(len(c)),
            ),
            robot,
        )
        for name, joint, settings, c in effects
    ]
    full = FullModel.of(robot, stages)
    moves = {
        "training": _wandering(seed, robot.n),
        "held_out": _wandering(seed + 1, robot.n),
        # The same way back: another log, with as much of every speed and posture.
        "other": _wandering(seed, robot.n)[::-1],
    }
    paths = [_written(folder / f"{name}.parquet", full, q) for name, q in moves.items()]
    training, held_out = (
        InputLog(path=path.name, sha256=sha256_of(path), samples=int(SECONDS * RATE_HZ))
        for path in paths[:2]
    )
    error = {name: JointRmse(rmse=NOISE) for name in robot.joint_names}
    loop = ClosedLoop(
        rounds=[],
        before=error,
        after=error,
        noise_floor=dict.fromkeys(robot.joint_names, NOISE),
        evaluated_on=[held_out.path],
        held_out=[held_out],
    )
    file = _file(robot, stages, [training], loop)
    write_json_atomic(folder / "refined.json", file)
    return Logged(
        folder=folder,
        robot=SAMPLES / rig / "robot.toml",
        file=folder / "refined.json",
        other=paths[2],
    )


def _file(
    robot: Robot, stages: Stages, inputs: list[InputLog], loop: ClosedLoop
) -> ParameterFile:
    return ParameterFile(
        **head(SCHEMA, now()),
        robot=robot_id(robot),
        inputs=inputs,
        stages=stages,
        closed_loop=loop,
    )


def _written(path: Path, full: FullModel, q: Array) -> Path:
    """Write a log of positions (N, n) rad, with the torque of the model and noise."""
    rng = np.random.default_rng(len(path.name))
    log = made_recording(q, np.zeros_like(q), rate_hz=RATE_HZ)
    tau, _ = full.predicted(log, full.motion(log))
    tau = tau + NOISE * rng.normal(size=tau.shape) * np.sqrt(0.5 * RATE_HZ / CUTOFF_HZ)
    return write_parquet(
        path, np.arange(len(q)) / RATE_HZ, full.robot.joint_names, q, torque=tau
    )


def _wandering(seed: int, n: int) -> Array:
    """Positions (N, n) rad: a stretch of one motion without end."""
    start_s = np.random.default_rng(seed).uniform(0.0, 1e4)
    t = start_s + np.arange(round(SECONDS * RATE_HZ))[:, None, None] / RATE_HZ
    hz = np.random.default_rng(1).uniform(0.2, 0.8, (16, n))
    return np.asarray(0.12 * np.sum(np.sin(2.0 * np.pi * hz * t), axis=1))
