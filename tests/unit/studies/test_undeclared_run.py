"""The study of undeclared effects: what is kept, and its tables."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import pytest

from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.studies import undeclared, undeclared_run
from tests.studies.undeclared_cases import (
    Condition,
    matrix,
    quick,
)
from tests.studies.undeclared_run import Choice, Record, key_of, run
from tests.studies.undeclared_tables import judged, reliability, tables
from tests.unit.studies.test_undeclared import diagnosis, finding

# ---- the store


def record(condition: Condition, found: DiagnosisFile | None, *, more: float = 0.5) -> Record:
    seconds = {} if found is None else {"diagnose": 2.0}
    shares = tuple((more, 0.0) for _ in condition.effects)
    return Record(key_of(condition), "now", condition, found, shares, seconds, "" if found else "x")


def test_an_interrupted_study_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is there is not run again; half a line is; other sources are other results."""
    ran: list[str] = []

    def fake(condition: Condition, cache: Path, sources: str, diagnose: object) -> Record:
        ran.append(key_of(condition))
        return replace(record(condition, diagnosis()), sources=sources)

    monkeypatch.setattr(undeclared_run, "run_case", fake)
    monkeypatch.setattr(undeclared_run, "package_sources", lambda: "now")
    cases = quick()[:3]
    assert len(run(Choice(cases[:2], False, tmp_path))) == 2
    path = undeclared_run.results_path(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    assert [r.key for r in run(Choice(cases, False, tmp_path))] == [key_of(c) for c in cases]
    assert len(ran) == 4
    assert set(ran) == set(map(key_of, cases))
    monkeypatch.setattr(undeclared_run, "package_sources", lambda: "later")
    assert run(Choice(cases, False, tmp_path, run=False)) == []
    assert len(run(Choice(cases, False, tmp_path, run=False, any_sources=True))) == 3
    assert len(ran) == 4
    run(Choice(cases, False, tmp_path, limit=1))
    assert len(ran) == 5


# ---- the choice


def parsed(*arguments: str) -> Namespace:
    parser = ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    undeclared.add_arguments(parser)
    return parser.parse_args(arguments)


def chosen(*arguments: str) -> Choice:
    return undeclared.choice_of(parsed(*arguments))


def test_parts_of_the_study_can_be_chosen() -> None:
    assert chosen().whole
    assert len(chosen().cases) == len(matrix())
    part = chosen("--rig", "two", "--seeds", "1-2", "--only-kind", "spring", "--size", "0.4")
    assert not part.whole
    assert {c.effects[0][0] for c in part.cases} == {"spring"}
    assert {(c.seed, c.rig, c.effects[0][2]) for c in part.cases} == {
        (1, "two", 0.4),
        (2, "two", 0.4),
    }
    assert {c.group for c in chosen("--groups", "pairs", "clean").cases} == {"pairs", "clean"}
    assert len(chosen("--quick").cases) == 11
    assert chosen("--limit", "5").limit == 5
    assert not chosen("--quick").whole


# ---- the tables


def test_tables_count_what_was_judged() -> None:
    spring = Condition("catalogue", "two", 0, (("spring", 1, 1.0),))
    found = diagnosis(finding("spring", "elbow", 0.97))
    cases = [
        record(spring, found),
        record(replace(spring, seed=1), diagnosis(finding("drift", "elbow", 0.96))),
        record(replace(spring, seed=2), diagnosis(), more=0.01),
        record(replace(spring, seed=3), None),
        record(Condition("clean", "six", 100), diagnosis()),
        record(Condition("clean", "six", 101), diagnosis(finding("drift", "elbow", 0.4))),
    ]
    text = tables(cases, 10)
    assert "6 of 10 cases; 1 failed, which counts as wrong" in text
    (row,) = (line for line in text.splitlines() if line.startswith("| spring | 33 %"))
    assert row.split(" | ")[1:3] == ["33 % of 3", "-"]
    assert "drift 1, failed 1" in row
    assert "| spring | 1 | 100 % of 1 | 0 % of 1 |" in text  # of the invisible ones
    assert "| as usual | - | 50 % of 2 |" in text
    assert "| 0.95 to 0.99 | 2 | 96 % | 50 % |" in reliability(judged(cases))
    assert "failed: catalogue/two/spring" in text
