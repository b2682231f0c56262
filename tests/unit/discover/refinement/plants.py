"""Logs of a two-joint arm that is simulated forwards, and the classical fit to them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.types import Robot
from tests.plants.cases import Case, declared_plant, injections, motions
from tests.plants.motions.trials import run_drill
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import recording_of, robot_of
from tests.studies.undeclared.refine import file_of

RIG, SECONDS, SEED = "vertical_two_joint", 11.0, 1
Effects = tuple[tuple[str, int, float], ...]  # name, joint, size


@dataclass(frozen=True, kw_only=True)
class Logs:
    """Logs of one arm, to be fitted and held out."""

    robot: Robot
    training: list[Recording]
    held_out: list[Recording]

    @property
    def earlier(self) -> dict[str, list[Recording]]:
        """Logs that the file was identified from, by stage."""
        return {"friction": self.training}

    def file(self) -> ParameterFile:
        """Return the classical model that the training logs give."""
        return file_of(
            self.robot, simultaneous(self.training, self.robot), self.earlier
        )


@cache
def recorded(effects: Effects) -> Logs:
    """Simulate the arm with effects that its robot file does not say."""
    case = Case(RIG, SEED, effects, seconds=SECONDS)
    declared = declared_plant(case)
    plant = injections(case)[-1].plant if effects else declared
    logs: dict[bool, list[Recording]] = {False: [], True: []}
    for number, drill in enumerate(motions(case)):
        made = run_drill(plant, drill, 1000 * SEED + number)
        logs[drill.held_out].append(recording_of(declared, drill.name, made))
    return Logs(
        robot=robot_of(RIG, declared), training=logs[False], held_out=logs[True]
    )
