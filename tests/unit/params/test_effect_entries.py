"""Effects in a parameter file: parts that contradict each other are named."""

from __future__ import annotations

import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.schema import EffectOfJoint, EffectSession
from tests.unit.params.documents import full_file

CASES = [
    ({"covariance": [[1.0, 0.0], [0.0, 1.0]]}, r"effects\[0\]\.covariance: must be square with 1"),
    ({"session": EffectSession(logs=["a"], starts=[0.0, 1.0], origin=0.0)}, r"session\.starts"),
    ({"session": EffectSession(logs=["a"], starts=[0.0])}, r"session\.origin"),
    ({"session": EffectSession(logs=["a"], origin=5.0)}, r"session\.origin"),
]


def effect(**changes: object) -> EffectOfJoint:
    plain = {"effect": "torque_bias", "joint": "elbow", "coefficients": [0.5]}
    return EffectOfJoint(**{**plain, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(("changes", "message"), CASES)
def test_contradictions_are_named(changes: dict[str, object], message: str) -> None:
    file = full_file()
    file.stages.effects = [effect(**changes)]
    with pytest.raises(ConfigError, match=message):
        check_consistency(file, "p.json")


def test_sessions_with_and_without_a_clock_are_fine() -> None:
    file = full_file()
    clocked = EffectSession(logs=["a", "b"], starts=[0.0, 9.0], origin=1.7e9)
    alone = EffectSession(logs=["a", "b"])
    file.stages.effects = [effect(session=clocked), effect(session=alone), effect()]
    check_consistency(file, "p.json")
