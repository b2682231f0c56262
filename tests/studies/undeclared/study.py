"""The study of undeclared effects: which cases are run, what is kept of them, and its
tables.
"""

import tempfile
import time
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import msgspec

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.studies.coverage.study import NAMES
from tests.studies.records import encoded, package_sources, results
from tests.studies.undeclared.cases import (
    RIG_NAMES,
    Condition,
    Group,
    Record,
    matrix,
    quick,
)
from tests.studies.undeclared.logs import (
    errors,
    excess,
    logs_of,
    plant_sources,
    stages_of,
)
from tests.studies.undeclared.tables import tables

# what a diagnosis depends on
PARTS = ("discover", "identify", "model", "motion", "robot")


def study(arguments: Namespace) -> str:
    cases, cache = {case.key: case for case in cases_of(arguments)}, arguments.cache
    sources = package_sources(*PARTS) + plant_sources()
    how = {
        "limit": arguments.limit,
        "processes": arguments.processes,
        "run": not arguments.tables,
    }
    how |= {
        "sources": sources,
        "told": _told,
        "failed": lambda record: bool(record.error),
    }
    work = partial(run_case, cache=cache)
    found = results(cases, work, Record, cache / "undeclared.jsonl", **how)
    made = (
        f"Made by `python -m tests.studies --only undeclared`, sources {sources[:12]}."
    )
    return f"{made}\n\n{tables(list(found.values()), len(cases))}"


def run_case(condition: Condition, cache: Path) -> Record:
    """Record, identify, diagnose with the options that a user has who sets none."""
    record = Record(condition, None, (), 0.0)
    try:
        logs, stages = logs_of(condition, cache), stages_of(condition, cache)
        own = errors(logs.held_out, logs.robot, stages)
        more = tuple(
            excess(condition, k, cache, own) for k in range(len(condition.effects))
        )
        record, clock = replace(record, excess=more), time.monotonic()
        said = diagnose(logs.training, logs.robot, stages, options=DiscoverOptions())
        # what is no number: error
        found = msgspec.json.decode(encoded(said), type=DiagnosisFile)
        return replace(
            record, diagnosis=found, seconds=round(time.monotonic() - clock, 2)
        )
    # whatever goes wrong is counted, and the study goes on
    except Exception as problem:
        return replace(record, error=f"{type(problem).__name__}: {problem}")


def _told(record: Record) -> str:
    if (found := record.diagnosis) is None:
        return record.error
    named = ", ".join(
        f"{f.effect}@{f.joint} {f.confidence:.2f}" for f in found.findings
    )
    return f"{found.verdict} {named} ({record.seconds:.0f} s)"


def add_arguments(parser: ArgumentParser) -> None:
    add = parser.add_argument_group("undeclared effects").add_argument
    folder = Path(tempfile.gettempdir()) / "seqid-study"
    add("--cache", type=Path, default=folder, help="logs and results (%(default)s)")
    add(
        "--processes",
        "--jobs",
        type=int,
        default=1,
        help="cases at a time (%(default)s)",
    )
    add("--only-kind", nargs="+", metavar="NAME", help="with one of these effects")
    add(
        "--rig",
        choices=list(dict.fromkeys([*RIG_NAMES, *NAMES])),
        help="one robot alone",
    )
    add("--seeds", metavar="A-B", help="these seeds alone (coverage: A:B)")
    add(
        "--fresh",
        type=int,
        default=0,
        metavar="N",
        help="add so much to seeds: other motions",
    )
    add("--size", type=float, help="effects of this size alone")
    add("--groups", nargs="+", choices=get_args(Group), help="parts of the study")
    add("--limit", type=int, metavar="N", help="at most N new cases this time")
    add("--tables", action="store_true", help="no runs, tables of what is there")


def cases_of(arguments: Namespace) -> list[Condition]:
    every = filter(
        partial(_chosen, arguments), quick() if arguments.quick else matrix()
    )
    return [replace(case, seed=case.seed + arguments.fresh) for case in every]


def whole(arguments: Namespace) -> bool:
    return cases_of(arguments) == list(matrix())


def _chosen(arguments: Namespace, condition: Condition) -> bool:
    names, _, sizes = (
        zip(*condition.effects, strict=True) if condition.effects else ((), (), ())
    )
    first, _, last = (arguments.seeds or "").partition("-")
    return (
        arguments.rig in (None, condition.rig)
        and (arguments.groups is None or condition.group in arguments.groups)
        and (
            arguments.only_kind is None
            or not set(names).isdisjoint(arguments.only_kind)
        )
        and (arguments.size is None or arguments.size in sizes)
        and (not first or int(first) <= condition.seed <= int(last or first))
    )
