"""Long logs of the two-joint arm, as files: one run through several motions, with
stamps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.discover.excerpts import Excerpts, take_excerpts
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.identify.log_set import LogSet
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
BEGUN = 1000.0  # s, on the log's clock
MOST = 429_760  # as MOST_VALUES counts: a good half of the log


@dataclass(frozen=True)
class LongCase:
    """A long recording, its robot, and the model fitted to it."""

    log: Recording
    robot: Robot
    stages: Stages

    def with_torque(self, torque: Array) -> LongCase:
        """The same with a torque (N, n) added to what is measured."""
        return replace(self, log=replace(self.log, tau=self.log.tau + torque))

    @property
    def file(self) -> ParameterFile:
        friction, inertia = self.stages.friction, self.stages.inertia
        return with_stage(
            None, robot_id(self.robot), [], friction=friction, inertia=inertia
        )

    def written(self, path: Path) -> Path:
        columns = {"t": BEGUN + self.log.t}
        for j, name in enumerate(self.robot.joint_names):
            columns[f"{name}.position"] = self.log.q[:, j]
            columns[f"{name}.torque"] = self.log.tau[:, j]
        pq.write_table(pa.table(columns), path, row_group_size=20_000)
        return path

    def pieces(self, path: Path, *, places: bool = True) -> Excerpts:
        logs = LogSet(logs=[self.written(path)], robot=self.robot)
        how = {
            "options": DiscoverOptions().motion,
            "most_values": MOST,
            "places": places,
        }
        return take_excerpts(logs, self.robot, self.stages, **how)


@cache
def long_case(*effects: tuple[str, int, float], seed: int = 1) -> LongCase:
    """Simulate the arm, with effects that its robot file does not say."""
    first = Case(RIG, seed, effects, seconds=10.0)
    declared = declared_plant(first)
    plant = injections(first)[-1].plant if effects else declared
    every = [motions(replace(first, seed=seed + k)) for k in range(3)]
    references = [
        drill.reference for drills in every for drill in drills if drill.name in MOTIONS
    ]
    drill = Drill("long", join(references), 20.0)
    log = replace(
        recording_of(declared, "long", run_drill(plant, drill, 1000 * seed)), start=0.0
    )
    robot = robot_of(RIG, declared)
    return LongCase(log, robot, simultaneous([log], robot))
