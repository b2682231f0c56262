"""The study of undeclared effects: what is kept, and its tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.studies import undeclared_run
from tests.studies.undeclared_cases import (
    Condition,
    quick,
)
from tests.studies.undeclared_run import Choice, Record, key_of, run
from tests.unit.studies.test_undeclared import diagnosis

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


# ---- the tables
