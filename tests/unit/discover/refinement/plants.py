"""Logs of a two-joint arm that is simulated forwards, and the classical fit to them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.types import Robot
from tests.plants.cases import Case, declared_plant, injections, motions
from tests.plants.motions.trials import run_drill
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import recording_of, robot_of
from tests.studies.undeclared.refine import file_of

RIG, SECONDS, SEED = "vertical_two_joint", 10.0, 1
Effects = tuple[tuple[str, int, float], ...]  # name, joint, size


@dataclass(frozen=True, kw_only=True)
class Logs:
    """Logs of one arm, to be fitted and held out; each simulated when asked for."""

    case: Case

    @cached_property
    def robot(self) -> Robot:
        """The robot file, which does not say the effects."""
        return robot_of(self.case.rig, declared_plant(self.case))

    @cached_property
    def training(self) -> list[Recording]:
        return self._simulated(held_out=False)

    @cached_property
    def held_out(self) -> list[Recording]:
        return self._simulated(held_out=True)

    def _simulated(self, *, held_out: bool) -> list[Recording]:
        declared = declared_plant(self.case)
        injected = injections(self.case)
        plant = injected[-1].plant if injected else declared
        logs = []
        for number, drill in enumerate(motions(self.case)):
            if drill.held_out == held_out:
                made = run_drill(plant, drill, 1000 * SEED + number)
                logs.append(recording_of(declared, drill.name, made))
        return logs

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
    """Return logs of the arm with effects that its robot file does not say."""
    return Logs(case=Case(RIG, SEED, effects, seconds=SECONDS))
