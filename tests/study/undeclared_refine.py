"""The loop closed on the study's cases: held-out error after refinement against the best there is.

The best there is: the error on the same logs without the effect, of a model identified without it.
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

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.results import ClosedLoop, Round
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import InputLog, ParameterFile, Stages
from seqid_cli.robot.types import Robot
from tests.plants.undeclared import CATALOGUE
from tests.study.tables import number, table
from tests.study.undeclared_cases import Condition
from tests.study.undeclared_logs import earlier_logs, errors, logs_of, stages_of
from tests.study.undeclared_run import (
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


@dataclass(frozen=True)
class Refined:
    """RMSE per joint N m on held-out logs: as the file is, refined, and the best there is."""

    key: str
    sources: str
    condition: Condition
    before: tuple[float, ...]
    after: tuple[float, ...]
    best: tuple[float, ...]
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
    from seqid_cli.discover.refine import refine

    return refine(training, held_out, robot, file, earlier=earlier, options=DiscoverOptions())


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
    rounds: tuple[Round, ...] = ()
    try:
        file = file_of(robot, stages, earlier)
        refined, loop = refine(logs.training, logs.held_out, robot, file, earlier)
        after, rounds = errors(logs.held_out, robot, refined).band, loop.rounds
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
        added=tuple(name for name, accepted in tried if accepted),
        refused=tuple(name for name, accepted in tried if not accepted),
        seconds=round(time.monotonic() - clock, 2),
        error=error,
    )


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


def share_left(record: Refined) -> float:
    """RMSE after refinement over the best there is, at the joint where it was worst before."""
    ratio = np.array(record.before) / np.array(record.best)
    worst = int(np.argmax(ratio))
    return record.after[worst] / record.best[worst]


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
            failed = str(len(group) - len(usable))
            rows.append([name, str(len(usable)), *cells, number(max(harm)), str(added), failed])
    header = ["held-out RMSE over that without the effect", "cases", "before, median"]
    header += ["after, median", "after, worst", "after over before, worst joint", "added", "failed"]
    return table(header, rows) if rows else ""


def _name(record: Refined) -> str:
    return record.condition.effects[0][0]
