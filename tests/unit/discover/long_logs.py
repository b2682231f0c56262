"""Long logs of the two-joint arm, as files: one run through several motions, with stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.cases import Case, declared_plant, injections, motions
from tests.plants.motions.trajectories import join
from tests.plants.motions.trials import Drill, run_drill
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import recording_of, robot_of

RIG = "vertical_two_joint"
MOTIONS = ("fast", "slow", "middle")  # begin and end at rest in the same posture
SECONDS = 10.0
ROUNDS = 3
BEGUN = 1000.0  # s, on the log's clock
GROUP = 20_000


@dataclass(frozen=True)
class LongCase:
    """A long recording, its robot, and the model fitted to it."""

    log: Recording
    robot: Robot
    stages: Stages

    def with_torque(self, torque: Callable[[Array], Array]) -> LongCase:
        """The same with a torque (N, n) of time (N,) added to what is measured."""
        return replace(self, log=replace(self.log, tau=self.log.tau + torque(self.log.t)))

    @property
    def file(self) -> ParameterFile:
        """The model as a parameter file."""
        friction, inertia = self.stages.friction, self.stages.inertia
        return with_stage(None, robot_id(self.robot), [], friction=friction, inertia=inertia)

    def written(self, path: Path) -> Path:
        """Write the log as Parquet, in row groups."""
        columns = {"t": BEGUN + self.log.t}
        for j, name in enumerate(self.robot.joint_names):
            columns[f"{name}.position"] = self.log.q[:, j]
            columns[f"{name}.torque"] = self.log.tau[:, j]
        pq.write_table(pa.table(columns), path, row_group_size=GROUP)
        return path


@cache
def long_case(*effects: tuple[str, int, float], seed: int = 1, rounds: int = ROUNDS) -> LongCase:
    """Simulate the arm, with effects that its robot file does not say."""
    first = Case(RIG, seed, effects, seconds=SECONDS)
    plant = injections(first)[-1].plant if effects else declared_plant(first)
    drills = [
        drill
        for k in range(rounds)
        for drill in motions(replace(first, seed=seed + k))
        if drill.name in MOTIONS
    ]
    long = Drill("long", join([drill.reference for drill in drills]), 20.0)
    declared = declared_plant(first)
    log = replace(recording_of(declared, "long", run_drill(plant, long, 1000 * seed)), start=0.0)
    robot = robot_of(RIG, declared)
    return LongCase(log, robot, simultaneous([log], robot))
