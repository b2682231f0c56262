"""Runs the cases of the study of undeclared effects and keeps what came out, line by line.

Every line of the results is one case, with the hash of the sources that it was made with; a case
that is there already is not run again, so that an interrupted study goes on where it stopped.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import msgspec
import numpy as np

import seqid_cli
from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests.studies.undeclared_cases import Condition
from tests.studies.undeclared_logs import (
    errors,
    excess,
    logs_of,
    plant_sources,
    sources_hash,
    stages_of,
)

PACKAGE = Path(seqid_cli.__file__).parent
PARTS = ("discover", "identify", "model", "motion", "robot")  # what a diagnosis depends on

Diagnose = Callable[[Sequence[Recording], Robot, Stages], DiagnosisFile]


@dataclass(frozen=True)
class Record:
    """What came out of one case.

    `excess` is, per true effect, by what share it raises each joint's held-out RMSE. Without a
    diagnosis `error` says why.
    """

    key: str
    sources: str
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
    any_sources: bool = False
    limit: int | None = None


def key_of(condition: Condition) -> str:
    """A name for a case, to search for in the results."""
    effects = "+".join(f"{name}@{joint}x{size:g}" for name, joint, size in condition.effects)
    parts = (condition.group, condition.rig, effects or "none", f"seed {condition.seed}")
    return "/".join((*parts, condition.start, condition.sensors))


def package_sources() -> str:
    """Hash of all that decides a result: the package's numerics and the simulator."""
    return sources_hash([PACKAGE / part for part in PARTS]) + plant_sources()


def standard(recordings: Sequence[Recording], robot: Robot, stages: Stages) -> DiagnosisFile:
    """Diagnose with the options that a user has who sets none."""
    return diagnose(recordings, robot, stages, options=DiscoverOptions())


def run_case(condition: Condition, cache: Path, sources: str, diagnose: Diagnose) -> Record:
    """Record, identify, diagnose; a failure is a result as well."""
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
        found = finite(diagnose(logs.training, logs.robot, stages))
        _lap(seconds, "diagnose", clock)
    except Exception as problem:  # whatever goes wrong is counted, and the study goes on
        error = f"{type(problem).__name__}: {problem}"
    return Record(key_of(condition), sources, condition, found, more, seconds, error)


def _lap(seconds: dict[str, float], name: str, since: float) -> float:
    now = time.monotonic()
    seconds[name] = round(now - since, 2)
    return now


def finite(diagnosis: DiagnosisFile) -> DiagnosisFile:
    """The diagnosis as the results' file gives it back: numbers that are none are an error."""
    return msgspec.json.decode(encoded(diagnosis), type=DiagnosisFile)


def encoded(value: object) -> bytes:
    """JSON, with numpy's scalars as numbers."""
    return msgspec.json.encode(value, enc_hook=_plain)


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} in a diagnosis")


class Keyed(Protocol):
    """A result of one case."""

    @property
    def key(self) -> str:
        """Which case."""
        ...

    @property
    def sources(self) -> str:
        """Hash of what it was made with."""
        ...


K = TypeVar("K", bound=Keyed)


def read(path: Path, kind: type[K]) -> list[K]:
    """Records of a results file; a line that an interruption cut off is left out."""
    records = []
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            records.append(msgspec.json.decode(line, type=kind))
        except msgspec.DecodeError:
            continue
    return records


def append(path: Path, record: Keyed) -> None:
    """Add a record, on a line of its own even after an interruption."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.is_file() and not path.read_bytes().endswith(b"\n")
    with path.open("ab") as stream:
        stream.write((b"\n" if cut else b"") + encoded(record) + b"\n")


def results_path(cache: Path) -> Path:
    """Where results are kept."""
    return cache / "undeclared.jsonl"


def latest(records: Iterable[K], cases: Sequence[Condition], sources: str | None) -> list[K]:
    """The last record of every case, in the order of the cases; of `sources` alone unless None."""
    by_key = {r.key: r for r in records if sources is None or r.sources == sources}
    return [by_key[key] for key in map(key_of, cases) if key in by_key]


def run(choice: Choice, diagnose: Diagnose = standard) -> list[Record]:
    """Run the cases that are not there yet; return the records of all of them."""
    path, sources = results_path(choice.cache), package_sources()
    wanted = None if choice.any_sources else sources
    done = {r.key for r in latest(read(path, Record), choice.cases, wanted) if not r.error}
    left = remaining(choice, done)
    work = partial(run_case, cache=choice.cache, sources=sources, diagnose=diagnose)
    for count, record in enumerate(mapped(work, left, choice.processes), start=1):
        append(path, record)
        _tell(record, count, len(left))
    return latest(read(path, Record), choice.cases, wanted)


def remaining(choice: Choice, done: Collection[str]) -> list[Condition]:
    """Cases to run, shuffled, so that the tables of a study half done are fair."""
    left = [c for c in choice.cases if key_of(c) not in done] if choice.run else []
    order = np.random.default_rng(0).permutation(len(left))
    return [left[k] for k in order][: choice.limit]


def mapped(
    work: Callable[[Condition], K], cases: Sequence[Condition], processes: int
) -> Iterator[K]:
    """Yield the cases' results as they come."""
    if processes == 1:
        yield from map(work, cases)
        return
    with ProcessPoolExecutor(processes) as pool:
        for future in as_completed([pool.submit(work, case) for case in cases]):
            yield future.result()


def _tell(record: Record, count: int, total: int) -> None:
    """One line per case to the screen, so that a long study shows how it goes."""
    if record.diagnosis is None:
        outcome = record.error
    else:
        named = [f"{f.effect}@{f.joint} {f.confidence:.2f}" for f in record.diagnosis.findings]
        outcome = f"{record.diagnosis.verdict} {', '.join(named)}"
    seconds = " ".join(f"{name} {value:.0f}" for name, value in record.seconds.items())
    sys.stderr.write(f"{count}/{total} {record.key}: {outcome} ({seconds} s)\n")
