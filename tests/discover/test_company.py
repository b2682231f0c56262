"""How sure findings are beside each other."""

from __future__ import annotations

import pytest

from seqid_cli.discover.company import beside_rest, ordered
from seqid_cli.discover.results import Finding, Unexplained


def found(
    effect: str,
    joint: str | None = "elbow",
    *,
    confidence: float = 0.99,
    explains: float = 0.9,
    gain: float = 0.5,
    **settings: float,
) -> Finding:
    return Finding(
        effect=effect,
        joint=joint,
        confidence=confidence,
        explains=explains,
        confusable_with=(),
        separate_by="",
        gain=gain,
        clean_gain=0.0,
        name_confidence=confidence,
        settings=settings,
    )


def wave(joint: str, gain: float, frequency: float) -> Finding:
    settings = {"frequency": frequency, "clocks": 0.0, "span": 100.0}
    return found("periodic_disturbance", joint, explains=0.0, gain=gain, **settings)


def test_the_weightiest_first_and_none_surer_than_it() -> None:
    small, large = found("spring", "wrist", explains=0.2), found("stribeck", confidence=0.8)
    row = ordered([small, large], {})
    assert [f.effect for f in row] == ["stribeck", "spring"]
    assert [f.confidence for f in row] == [0.8, 0.8]


def test_one_wave_at_two_joints_may_be_one() -> None:
    row = ordered([wave("wrist", 0.4, 7.301), wave("elbow", 4.0, 7.3)], {})
    assert [(f.joint, f.confidence) for f in row] == [("elbow", 0.99), ("wrist", 0.99 / 2)]
    assert "elbow" in row[1].note
    assert not row[0].note


def test_two_waves_are_two() -> None:
    row = ordered([wave("wrist", 0.4, 7.4), wave("elbow", 4.0, 7.3)], {})
    assert [f.confidence for f in row] == [0.99, 0.99]


def test_alike_at_one_joint_may_be_one() -> None:
    row = ordered([found("spring"), found("torque_bias", explains=0.1)], {})
    assert [f.confidence for f in row] == [0.99, 0.99 / 2]
    assert row[0].confusable_with == ("torque_bias",)


def test_less_sure_beside_more_that_is_unknown() -> None:
    rest = Unexplained(joint="elbow", depends_on=("position",), share=0.8, curve=None)
    told = beside_rest(found("stribeck", explains=0.5), [rest])
    assert told.confidence == pytest.approx(0.99 * 0.5 / 0.9)
    assert beside_rest(found("stribeck", "wrist"), [rest]).confidence == 0.99


def test_after_the_first_a_louder_joint_makes_less_sure() -> None:
    row = ordered([found("stribeck"), found("drift", explains=0.5)], {"elbow": 0.8})
    assert row[0].confidence == 0.99
    assert row[1].confidence < 0.6


def test_a_first_that_explains_little_where_much_is_left_is_less_sure() -> None:
    """A wave above the cut-off is judged there."""
    loud = {"elbow": 0.85}
    (little,) = ordered([found("transmission_coupling", explains=0.2)], loud, ["elbow"])
    assert little.confidence == pytest.approx(0.99 * 0.2 / (0.2 + 0.85 * 0.8))
    untold, most = (found("backlash", explains=x) for x in (0.2, 0.6))
    assert ordered([untold], loud)[0].confidence == 0.99
    assert ordered([most], loud, ["elbow"])[0].confidence == 0.99
    assert ordered([wave("elbow", 0.4, 7.3)], loud, ["elbow"])[0].confidence == 0.99
