"""The study of undeclared effects: its rules and its matrix."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry, UnexplainedPart
from tests.studies.undeclared.cases import Truth
from tests.studies.undeclared.score import both_found, score
from tests.unit.params.documents import diagnosis_of

SPRING = Truth("spring", "spring", ("elbow",), ("position",))
PAYLOAD = Truth("payload", "payload", (None,), ())
BUMP = Truth("outside.bump", None, ("elbow",), ("position", "direction"))


def finding(
    effect: str, joint: str | None, confidence: float = 0.9, also: tuple[str, ...] = ()
) -> FindingEntry:
    return FindingEntry(
        effect=effect,
        joint=joint,
        confidence=confidence,
        name_confidence=confidence,
        explains=0.8,
        confusable_with=list(also),
        separate_by="",
        gain=0.5,
    )


def diagnosis(
    *findings: FindingEntry, unexplained: Sequence[UnexplainedPart] = ()
) -> DiagnosisFile:
    verdict = "effect_found" if findings else "unexplained" if unexplained else "nothing_missing"
    return diagnosis_of(verdict, findings, unexplained)  # type: ignore[arg-type]


def test_right_is_kind_and_joint_of_the_first_finding() -> None:
    assert score(diagnosis(finding("spring", "elbow")), [SPRING]).right
    assert not score(diagnosis(finding("spring", "shoulder")), [SPRING]).right
    assert not score(diagnosis(finding("spring", None)), [SPRING]).right
    second = score(diagnosis(finding("drift", "elbow"), finding("spring", "elbow")), [SPRING])
    assert not second.right
    assert second.anywhere
    assert not score(diagnosis(), [SPRING]).right


def test_stated_confusable_effects_count_at_the_same_joint() -> None:
    vague = score(diagnosis(finding("torque_bias", "elbow", also=("spring",))), [SPRING])
    assert vague.right
    assert not vague.own_name
    assert not vague.sure_and_wrong
    away = score(diagnosis(finding("torque_bias", "shoulder", also=("spring",))), [SPRING])
    assert away.kind_right
    assert not away.right
    assert away.sure_and_wrong


def test_unexplained_needs_the_joint_and_a_quantity() -> None:
    def judge(joint: str, *quantities: str, named: bool = False) -> tuple[bool, bool]:
        found = diagnosis(
            *([finding("drift", "elbow")] if named else []),
            unexplained=[UnexplainedPart(joint=joint, depends_on=list(quantities), share=0.4)],
        )
        result = score(found, [BUMP])
        return result.explained_away, result.all_quantities

    assert judge("elbow", "position") == (True, False)
    assert judge("elbow", "direction", "position", "velocity") == (True, True)
    assert judge("elbow", "velocity") == (False, False)
    assert judge("shoulder", "position", "direction") == (False, False)
    assert judge("elbow", "position", named=True) == (False, False)


def test_two_effects_need_two_findings() -> None:
    spring = finding("spring", "elbow", also=("torque_bias",))
    bias = Truth("torque_bias", "torque_bias", ("elbow",), ())
    assert both_found(diagnosis(finding("payload", None), spring), [SPRING, PAYLOAD])
    assert not both_found(diagnosis(spring), [SPRING, bias])
    assert not both_found(diagnosis(spring, finding("drift", "elbow")), [SPRING, bias])
    other = finding("drift", "elbow", also=("spring",))
    assert both_found(diagnosis(spring, other), [SPRING, bias])
    assert both_found(diagnosis(other, spring), [SPRING, bias])
