"""Does `plan discriminate` separate what the logs at hand do not tell apart? On two joints.

Each case: an effect at a joint, one slow or fast log in which its name is open, the motion planned
against the first rival that motion can settle, recorded on the same plant, and a second diagnosis.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.results.diagnosis import FindingEntry
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import belief_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.discriminate import plan_discriminate
from seqid_cli.robot.types import Robot
from tests.plants.planned import recorded
from tests.plants.undeclared import REGISTRY
from tests.studies.tables import table
from tests.studies.undeclared_cases import Condition, built
from tests.studies.undeclared_logs import logs_of, stages_of

SECONDS = 48.0
MOVE_S = 8.0
LATER_S = 2000.0  # s since power-on, when the planned moves are recorded
EARLIER = 50  # added to the seed: the model is of logs without the effect
NAMES = tuple(
    name
    for name, effect in CATALOGUE.items()
    if effect.by_motion and name in REGISTRY and name != "rotor_inertia"
)


@dataclass(frozen=True)
class Outcome:
    """One case: the rivals before and after, and what the plan said."""

    effect: str
    joint: str
    log: str
    before: Sequence[str]
    rival: str
    imitated: float | None
    after: Sequence[str] | None
    special: bool = False  # the effect is a special case of the rival, which always explains it

    @property
    def separated(self) -> bool:
        """Whether the effect is found afterwards, and no longer confused with the rival."""
        return self.after is not None and self.rival not in self.after


def study(chosen: argparse.Namespace) -> str:
    """Rivals before and after the planned motion, case by case, at the second joint."""
    names = NAMES[:2] if chosen.quick else NAMES
    found = list(cases(chosen.cache, seeds=(0,), names=names, joints=(1,)))
    rows = [[o.effect, o.log, ", ".join(o.before), o.rival, *_answers(o)] for o in found]
    planned = [o for o in found if o.imitated is not None and not o.special]
    head = ["effect", "log", "confusable with", "planned against", "imitated", "separated"]
    text = f"{sum(o.separated for o in planned)} of {len(planned)} planned cases are separated."
    return f"{text}\n\n{table(head, rows)}"


def _answers(outcome: Outcome) -> tuple[str, str]:
    if outcome.imitated is None:
        return "-", "no motion can"
    if outcome.special:
        return f"{outcome.imitated:.0%}", "a special case"
    return f"{outcome.imitated:.0%}", "yes" if outcome.separated else "no"


def cases(
    cache: Path, *, seeds: Sequence[int], names: Sequence[str] = NAMES, joints: Sequence[int]
) -> Iterator[Outcome]:
    """All cases in which a log leaves the name open."""
    for seed in seeds:
        stages = stages_of(Condition("clean", "two", seed + EARLIER), cache)
        for name in names:
            for joint in joints:
                if name == "transmission_coupling" and joint == 0:
                    continue
                case = Condition("catalogue", "two", seed, ((name, joint, 1.0),))
                logs = logs_of(case, cache)
                for log in logs.training:
                    if log.path.name in ("slow", "fast"):
                        yield from _outcome(case, logs.robot, stages, log)


def _finding(
    logs: Sequence[Recording], robot: Robot, stages: Stages, effect: str
) -> FindingEntry | None:
    """The finding that is the effect, or may be it."""
    found = diagnose(logs, robot, stages, options=DiscoverOptions()).findings
    return next((f for f in found if effect in (f.effect, *f.confusable_with)), None)


def _outcome(case: Condition, robot: Robot, stages: Stages, log: Recording) -> Iterator[Outcome]:
    effect, joint, _ = case.effects[0]
    before = _finding([log], robot, stages, effect)
    if before is None:
        return
    names = [n for n in (before.effect, *before.confusable_with) if n != effect]
    for rival in names:
        if CATALOGUE[rival].by_motion:
            yield _separated(case, robot, stages, log, names, rival)
            return
    if names:
        at = robot.joint_names[joint]
        yield Outcome(effect, at, log.path.name, names, names[0], None, None)


def _separated(
    case: Condition, robot: Robot, stages: Stages, log: Recording, names: list[str], rival: str
) -> Outcome:
    effect, joint, _ = case.effects[0]
    at = robot.joint_names[joint]
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.4))
    options = PlanOptions(
        duration_s=SECONDS, move_s=MOVE_S, between=(effect, rival), joint=at, seed=case.seed
    )
    planned = plan_discriminate(belief, stages, options)
    told = planned.stage.separation
    outcome = Outcome(effect, at, log.path.name, names, rival, told and told.imitated, None)
    if told is None:
        return outcome
    special = told.special_case == effect
    more = recorded(built(case)[0], planned.moves, case.seed, start=LATER_S)
    after = _finding([log, *more], robot, stages, effect)
    left = None if after is None else [after.effect, *after.confusable_with]
    return Outcome(effect, at, log.path.name, names, rival, told.imitated, left, special)
