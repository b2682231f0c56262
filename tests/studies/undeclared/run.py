"""Runs the cases of the study of undeclared effects; a failure is a result as well."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.studies.records import encoded, package_sources, results
from tests.studies.undeclared.cases import Condition
from tests.studies.undeclared.logs import errors, excess, logs_of, plant_sources, stages_of

PARTS = ("discover", "identify", "model", "motion", "robot")  # what a diagnosis depends on


@dataclass(frozen=True)
class Record:
    """What came out of one case.

    `excess` is, per true effect, by what share it raises each joint's held-out RMSE. Without a
    diagnosis `error` says why.
    """

    condition: Condition
    diagnosis: DiagnosisFile | None
    excess: tuple[tuple[float, ...], ...]
    seconds: Mapping[str, float]
    error: str = ""


@dataclass(frozen=True)
class Choice:
    """Which cases are run, and how.

    `whole` if no case of the study is left out; `limit` is how many are run at most this time.
    """

    cases: tuple[Condition, ...]
    whole: bool
    cache: Path
    processes: int = 1
    run: bool = True  # else what is there
    limit: int | None = None


def sources() -> str:
    """Hash of all that decides a result: the package's numerics and the simulator."""
    return package_sources(*PARTS) + plant_sources()


def run_case(condition: Condition, cache: Path) -> Record:
    """Record, identify, diagnose with the options that a user has who sets none."""
    seconds: dict[str, float] = {}
    found, error = None, ""
    more: tuple[tuple[float, ...], ...] = ()
    clock = time.monotonic()
    try:
        logs = logs_of(condition, cache)
        clock = _lap(seconds, "simulate", clock)
        stages = stages_of(condition, cache)
        clock = _lap(seconds, "identify", clock)
        own = errors(logs.held_out, logs.robot, stages)
        more = tuple(excess(condition, k, cache, own) for k in range(len(condition.effects)))
        clock = _lap(seconds, "compare", clock)
        said = diagnose(logs.training, logs.robot, stages, options=DiscoverOptions())
        found = msgspec.json.decode(encoded(said), type=DiagnosisFile)  # what is no number: error
        _lap(seconds, "diagnose", clock)
    except Exception as problem:  # whatever goes wrong is counted, and the study goes on
        error = f"{type(problem).__name__}: {problem}"
    return Record(condition, found, more, seconds, error)


def _lap(seconds: dict[str, float], name: str, since: float) -> float:
    now = time.monotonic()
    seconds[name] = round(now - since, 2)
    return now


def run(choice: Choice) -> list[Record]:
    """Run the cases that are not there yet; return the records of all of them."""
    found = results(
        {case.key: case for case in choice.cases},
        partial(run_case, cache=choice.cache),
        Record,
        choice.cache / "undeclared.jsonl",
        sources=sources(),
        run=choice.run,
        limit=choice.limit,
        processes=choice.processes,
        told=_told,
        failed=lambda record: bool(record.error),
    )
    return list(found.values())


def _told(record: Record) -> str:
    """One line per case to the screen, so that a long study shows how it goes."""
    if record.diagnosis is None:
        return record.error
    named = [f"{f.effect}@{f.joint} {f.confidence:.2f}" for f in record.diagnosis.findings]
    seconds = " ".join(f"{name} {value:.0f}" for name, value in record.seconds.items())
    return f"{record.diagnosis.verdict} {', '.join(named)} ({seconds} s)"
