"""The loop closed on the study's cases: held-out error after refinement against two references.

One is a model that was told which effects there are, and at which joints: it is fitted to the same
logs by the same recipe. The other is the error on the same logs without the effect, of a model that
was identified without it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Stage, candidates_of
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.loop import with_effects
from seqid_cli.discover.refinement.material import Material, Refitted
from seqid_cli.discover.refinement.reidentify import refitted
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import FREE, HELD, Ground, Model
from seqid_cli.discover.select.tuning import Tuner
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE as EFFECTS
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import ClosedLoop, InputLog, ParameterFile, RefinementRound, Stages
from seqid_cli.robot.types import Robot
from tests.plants.undeclared import CATALOGUE
from tests.studies.tables import number, table
from tests.studies.undeclared_cases import Condition, Truth, built
from tests.studies.undeclared_logs import earlier_logs, errors, logs_of, stages_of
from tests.studies.undeclared_run import (
    Choice,
    append,
    key_of,
    latest,
    mapped,
    package_sources,
    read,
    remaining,
)

Array = NDArray[np.float64]
Refine = Callable[
    [Sequence[Recording], Sequence[Recording], Robot, ParameterFile, Mapping[str, list[Recording]]],
    tuple[Stages, ClosedLoop],
]
GROUPS = ("catalogue", "clean", "outside", "pairs")
NEAR = 1.15  # of a model told the effects: that is as good


@dataclass(frozen=True)
class Refined:
    """Held-out RMSE per joint N m: as the file is, refined, told, and without the effect."""

    key: str
    sources: str
    condition: Condition
    before: tuple[float, ...]
    after: tuple[float, ...]
    best: tuple[float, ...]
    told: tuple[float, ...]  # empty where no model can be told, or it could not be fitted
    added: tuple[str, ...]
    refused: tuple[str, ...]
    seconds: float
    error: str = ""


def standard(
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    robot: Robot,
    file: ParameterFile,
    earlier: Mapping[str, list[Recording]],
) -> tuple[Stages, ClosedLoop]:
    """Refine with the options that a user has who sets none."""
    from seqid_cli.discover.refinement.confirm import confirm
    from seqid_cli.discover.refinement.rounds import refine

    found = refine(training, robot, file, earlier=earlier, options=DiscoverOptions())
    return found.stages, confirm(found, held_out)


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


def refine_case(condition: Condition, cache: Path, sources: str, refine: Refine) -> Refined:
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
        refined, loop = refine(logs.training, logs.held_out, robot, file, earlier)
        after = errors(logs.held_out, robot, refined).band
        rounds = (*loop.rounds, *loop.refused)
        material = Material(tuple(logs.training), earlier, robot, DiscoverOptions())
        told = _told(material, stages, condition, logs.held_out)
    except Exception as problem:  # whatever goes wrong is counted, and the study goes on
        error = f"{type(problem).__name__}: {problem}"
    tried = [(f"{r.effect}@{r.joint}", r.accepted) for r in rounds]
    return Refined(
        key=key_of(condition),
        sources=sources,
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


def refinements(choice: Choice, refine: Refine = standard) -> list[Refined]:
    """Refine the cases of `GROUPS` that are not there yet; return what is there of all of them."""
    path, sources = choice.cache / "refined.jsonl", package_sources()
    cases = tuple(c for c in choice.cases if c.group in GROUPS)
    wanted = None if choice.any_sources else sources
    done = {r.key for r in latest(read(path, Refined), cases, wanted) if not r.error}
    left = remaining(replace(choice, cases=cases), done)
    work = partial(refine_case, cache=choice.cache, sources=sources, refine=refine)
    for count, record in enumerate(mapped(work, left, choice.processes), start=1):
        append(path, record)
        outcome = record.error or ", ".join(record.added) or "nothing added"
        sys.stderr.write(f"{count}/{len(left)} refine {record.key}: {outcome}\n")
    return latest(read(path, Refined), cases, wanted)


def share_left(record: Refined, reference: Sequence[float] | None = None) -> float:
    """RMSE after refinement over a reference, at the joint where the effect raised it the most.

    The reference is the error without the effect, unless given.
    """
    ratio = np.array(record.before) / np.array(record.best)
    worst = int(np.argmax(ratio))
    return record.after[worst] / (reference or record.best)[worst]


def refined_table(records: Sequence[Refined]) -> str:
    """Per kind: what is left above the best there is."""
    groups = {
        name: [r for r in records if r.condition.group == "catalogue" and _name(r) == name]
        for name in CATALOGUE
    }
    groups["all of these"] = [r for r in records if r.condition.group == "catalogue"]
    for label in ("clean", "outside", "pairs"):
        groups[label] = [r for r in records if r.condition.group == label]
    rows = []
    for name, group in groups.items():
        usable = [r for r in group if not r.error]
        if usable:
            left = [share_left(r) for r in usable]
            was = [max(np.array(r.before) / np.array(r.best)) for r in usable]
            harm = [max(np.array(r.after) / np.array(r.before)) for r in usable]
            added = sum(bool(r.added) for r in usable)
            cells = [number(float(x)) for x in (np.median(was), np.median(left), max(left))]
            beside = [share_left(r, r.told) for r in usable if r.told]
            cells += [number(float(max(beside))), within(beside)] if beside else ["-", "-"]
            failed = str(len(group) - len(usable))
            rows.append([name, str(len(usable)), *cells, number(max(harm)), str(added), failed])
    header = ["held-out RMSE over that without the effect", "cases", "before, median"]
    header += ["after, median", "after, worst", "over that of a model told the effects, worst"]
    header += [f"within {NEAR}", "after over before, worst joint", "added", "failed"]
    return table(header, rows) if rows else ""


def within(ratios: Sequence[float]) -> str:
    """How many ratios are at most `NEAR`."""
    return f"{sum(x <= NEAR for x in ratios)} of {len(ratios)}"


def _name(record: Refined) -> str:
    return record.condition.effects[0][0]
