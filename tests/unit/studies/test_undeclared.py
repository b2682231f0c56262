"""How the study of undeclared effects judges a diagnosis."""

from typing import Any

import pytest
from msgspec.structs import replace

from tests.studies.undeclared.cases import Condition, Record, matrix
from tests.studies.undeclared.score import FAILED, judged
from tests.studies.undeclared.tables import tables
from tests.unit.params.documents import diagnosis_file

STRIBECK, SPRING, BESIDE = ("stribeck", 1, 1.0), ("spring", 0, 1.0), ("spring", 1, 1.0)
(FOUND,) = diagnosis_file().findings[:1]
ALIKE = replace(
    FOUND, joint="elbow", effect="presliding_hysteresis", confusable_with=["stribeck"]
)
(PART,) = diagnosis_file().unexplained[:1]
FIRST = "right kind_right own_name found"
HITS = (
    "right",
    "kind_right",
    "own_name",
    "found",
    "all_found",
    "sure_and_wrong",
    "explained_away",
)


def record(
    *effects: tuple[str, int, float], share: float = 0.03, **said: Any
) -> Record:
    diagnosis = replace(FAILED, **{"verdict": "effects_missing", **said})
    case = Condition("pairs", "two", 1, effects)
    return Record(case, diagnosis, ((0.0, share),) * len(effects), 1.0)


ELBOW, SHOULDER = replace(FOUND, joint="elbow"), replace(FOUND, joint="shoulder")
EITHER = replace(ELBOW, confusable_with=["spring"])
UNEXPLAINED = {
    "unexplained": [replace(PART, joint="shoulder")],
    "verdict": "unexplained",
}


@pytest.mark.parametrize(
    ("effects", "said", "hits"),
    [
        ([STRIBECK], {"findings": [ELBOW]}, f"{FIRST} all_found"),
        ([STRIBECK], {"findings": [ALIKE]}, "right kind_right found all_found"),
        ([STRIBECK], {"findings": [SHOULDER]}, "kind_right sure_and_wrong"),
        ([STRIBECK], {"findings": [replace(SHOULDER, confidence=0.8)]}, "kind_right"),
        ([STRIBECK, SPRING], {"findings": [ELBOW]}, FIRST),
        ([STRIBECK, BESIDE], {"findings": [EITHER]}, FIRST),
        ([STRIBECK, BESIDE], {"findings": [EITHER] * 2}, f"{FIRST} all_found"),
        ([SPRING, STRIBECK], {"findings": [ELBOW]}, "found"),
        ([SPRING], UNEXPLAINED, "explained_away"),
        ([SPRING], UNEXPLAINED | {"verdict": "effects_missing"}, ""),
        ([BESIDE], UNEXPLAINED, ""),
    ],
)
def test_a_diagnosis_is_worth_what_it_says(
    effects: Any, said: dict[str, Any], hits: str
) -> None:
    case = judged(record(*effects, **said))
    assert {name for name in HITS if getattr(case, name)} == set(hits.split())


def test_what_does_not_show_is_not_counted_and_a_failure_is_wrong() -> None:
    assert judged(record(STRIBECK)).seen
    assert not judged(record(STRIBECK, share=0.01)).seen
    assert not judged(record(("payload", 0, 1.0))).seen  # the model has it
    failed = Record(record(STRIBECK).condition, None, (), 0.0, "ValueError: no")
    assert not judged(failed).right
    assert not judged(failed).quiet
    text = tables([record(STRIBECK, SPRING, findings=[]), failed], 3)
    assert "2 of 3 cases; 1 failed" in text
    assert "failed: pairs/two/stribeck@1x1/seed 1" in text


def test_no_case_comes_twice() -> None:
    keys = [case.key for case in matrix()]
    assert len(keys) == len(set(keys)) > 1000
