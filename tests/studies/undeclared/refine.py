"""The loop closed on the study's cases: held-out error after refinement against two references.

One is a model that was told which effects there are, and at which joints: it is fitted to the same
logs by the same recipe. The other is the error on the same logs without the effect, of a model that
was identified without it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Stage, candidates_of
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.loop import with_effects
from seqid_cli.discover.refinement.material import Material, Refitted
from seqid_cli.discover.refinement.reidentify import refitted
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import FREE, HELD, Ground, Model
from seqid_cli.discover.select.tuning import Tuner
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE as EFFECTS
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import InputLog, ParameterFile, Stages
from seqid_cli.robot.types import Robot
from tests.plants.effects.registry import CATALOGUE
from tests.studies.tables import counted, grouped, median_of, number
from tests.studies.undeclared.cases import Condition, Truth, built
from tests.studies.undeclared.logs import earlier_logs, errors, logs_of, stages_of
from tests.studies.undeclared.run import Choice, kept

Array = NDArray[np.float64]
GROUPS = ("catalogue", "clean", "outside", "pairs")
NEAR = 1.15  # of a model told the effects: that is as good


@dataclass(frozen=True)
class Refined:
    """Held-out RMSE per joint N m: as the file is, refined, told, and without the effect."""

    condition: Condition
    before: tuple[float, ...]
    after: tuple[float, ...]
    best: tuple[float, ...]
    told: tuple[float, ...]  # empty where no model can be told, or it could not be fitted
    added: tuple[str, ...]
    refused: tuple[str, ...]
    seconds: float
    error: str = ""


def file_of(robot: Robot, stages: Stages, logs: Mapping[str, Sequence[Recording]]) -> ParameterFile:
    """The parameter file of stages that were identified from logs."""
    inputs = [
        InputLog(path=str(r.path), sha256=r.sha256, samples=len(r.t), stage=stage)
        for stage, recordings in logs.items()
        for r in recordings
    ]
    return with_stage(
        None,
        robot_id(robot),
        inputs,
        friction=stages.friction,
        gravity=stages.gravity,
        inertia=stages.inertia,
    )


def refine_case(condition: Condition, cache: Path) -> Refined:
    """Record, identify, refine, compare with the file that the plant without effects gives."""
    logs, best = logs_of(condition, cache), _without_effects(condition, cache)
    stages, robot = stages_of(condition, cache), logs.robot
    before = errors(logs.held_out, robot, stages).band
    earlier = {stage: list(x) for stage, x in earlier_logs(condition, cache).items()}
    clock, after, error = time.monotonic(), before, ""
    rounds: tuple[RefinementRound, ...] = ()
    told: tuple[float, ...] = ()
    try:
        file = file_of(robot, stages, earlier)
        decided = refine(logs.training, robot, file, earlier=earlier, options=DiscoverOptions())
        loop = confirm(decided, logs.held_out)
        after = errors(logs.held_out, robot, decided.stages).band
        rounds = (*loop.rounds, *loop.refused)
        material = Material(tuple(logs.training), earlier, robot, DiscoverOptions())
        told = _told(material, stages, condition, logs.held_out)
    except Exception as problem:  # whatever goes wrong is counted, and the study goes on
        error = f"{type(problem).__name__}: {problem}"
    tried = [(f"{r.effect}@{r.joint}", r.accepted) for r in rounds]
    return Refined(
        condition=condition,
        before=_plain(before),
        after=_plain(after),
        best=best,
        told=told,
        added=tuple(name for name, accepted in tried if accepted),
        refused=tuple(name for name, accepted in tried if not accepted),
        seconds=round(time.monotonic() - clock, 2),
        error=error,
    )


def _told(
    material: Material, stages: Stages, condition: Condition, held_out: Sequence[Recording]
) -> tuple[float, ...]:
    """Error of the model that is told its effects, under the better account of when they came."""
    truths = built(condition)[1]
    models = [told_model(material, stages, truths, late=late) for late in (False, True)]
    found = [errors(held_out, material.robot, m).band for m in models if m is not None]
    return _plain(min(found, key=lambda band: float(np.sum(band**2)))) if found else ()


def told_model(
    material: Material, stages: Stages, truths: Sequence[Truth], *, late: bool
) -> Stages | None:
    """The model that is told its effects and their joints; None where they cannot be told."""
    if not truths or any(t.kind not in EFFECTS for t in truths):
        return None
    scenes = scenes_of(material.training, material.robot, stages, options=material.options.motion)
    rows = rows_of(scenes)
    model = Model(Ground.of(Stage(rows), base_of(rows, stages)), HELD if late else FREE)
    for truth in truths:
        names = material.robot.joint_names
        tuner = Tuner(model.ground.stage, model.linear, model.ground.size)
        every = candidates_of(scenes, [EFFECTS[str(truth.kind)]], model.left())
        here = [c for c in every if (None if c.joint is None else names[c.joint]) in truth.joints]
        tried = sorted(tuner.tried(here), key=lambda one: -one.evidence)
        if not tried:
            return None
        model.add([tuner.tuned(tried[0]).candidate])
    candidates = model.candidates
    came = frozenset(c.key for c in candidates) if late else frozenset()
    start = Refitted(stages, (), came)
    return with_effects(refitted(material, start, candidates, late=came, kept=late), material.robot)


def _without_effects(condition: Condition, cache: Path) -> tuple[float, ...]:
    bare = replace(condition, effects=())
    logs = logs_of(bare, cache)
    return _plain(errors(logs.held_out, logs.robot, stages_of(bare, cache)).band)


def _plain(values: Array) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


def refinements(choice: Choice) -> list[Refined]:
    """Refine the cases of `GROUPS` that are not there yet; return what is there of all of them."""
    cases = [case for case in choice.cases if case.group in GROUPS]
    return kept(choice, cases, refine_case, Refined, "refined.jsonl", _added)


def _added(record: Refined) -> str:
    return record.error or ", ".join(record.added) or "nothing added"


def share_left(record: Refined, reference: Sequence[float] | None = None) -> float:
    """RMSE after refinement over a reference, at the joint where the effect raised it the most.

    The reference is the error without the effect, unless given.
    """
    ratio = np.array(record.before) / np.array(record.best)
    worst = int(np.argmax(ratio))
    return record.after[worst] / (reference or record.best)[worst]


def refined_table(records: Sequence[Refined]) -> str:
    """Per kind: what is left above the best there is."""
    alone = [r for r in records if r.condition.group == "catalogue"]
    groups = {name: [r for r in alone if _name(r) == name] for name in CATALOGUE}
    groups["all of these"] = alone
    for label in ("clean", "outside", "pairs"):
        groups[label] = [r for r in records if r.condition.group == label]
    columns: dict[str, Callable[[Sequence[Refined]], str]] = {
        "cases": counted,
        "before, median": median_of(lambda r: max(np.array(r.before) / np.array(r.best))),
        "after, median": median_of(share_left),
        "after, worst": lambda own: number(max(map(share_left, own))),
        "over that of a model told the effects, worst": lambda own: number(
            max(_over_told(own), default=float("nan"))
        ),
        f"within {NEAR}": lambda own: _within(_over_told(own)),
        "after over before, worst joint": lambda own: number(
            max(max(np.array(r.after) / np.array(r.before)) for r in own)
        ),
        "added": lambda own: str(sum(bool(r.added) for r in own)),
    }
    return grouped(
        "held-out RMSE over that without the effect",
        {name: own for name, own in groups.items() if _usable(own)},
        {name: lambda own, cell=cell: cell(_usable(own)) for name, cell in columns.items()}
        | {"failed": lambda own: str(len(own) - len(_usable(own)))},
    )


def _usable(records: Sequence[Refined]) -> list[Refined]:
    return [r for r in records if not r.error]


def _over_told(own: Sequence[Refined]) -> list[float]:
    return [share_left(r, r.told) for r in own if r.told]


def _within(ratios: Sequence[float]) -> str:
    """How many ratios are at most `NEAR`."""
    return f"{sum(x <= NEAR for x in ratios)} of {len(ratios)}" if ratios else "-"


def _name(record: Refined) -> str:
    return record.condition.effects[0][0]
