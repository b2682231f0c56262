"""Which case a seed stands for, and how answers are judged and counted."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seqid_cli.effects.registry import CATALOGUE
from tests.studies.outside.__main__ import answers
from tests.studies.outside.effects import KINDS, MORE
from tests.studies.outside.foreign import FOREIGN
from tests.studies.outside.plan import (
    COMES_LATER,
    MANY,
    PUBLISHED,
    drawn,
    kinds_of,
    outlined,
)
from tests.studies.outside.score import QUANTITIES, label, silent, surely_wrong


def answer(**changed: Any) -> dict[str, Any]:
    row = {
        "seed": 1,
        "kinds": ["stribeck"],
        "joints": ["j2"],
        "shares": [0.05],
        "flow": "late",
    }
    row |= {
        "arm": "drawn",
        "n": 2,
        "imu": False,
        "error": "",
        "findings": [],
        "unexplained": [],
    }
    return row | {"events": [], "residuals": {"j2": [0.3, 0.1, 0.3]}} | changed


def finding(
    effect: str, joint: str = "j2", confidence: float = 0.95, **own: Any
) -> dict[str, Any]:
    return {"effect": effect, "joint": joint, "confidence": confidence, "alike": []} | {
        "name_confidence": confidence,
        **own,
    }


def test_seeds_cover_the_catalogue_and_clean_arms() -> None:
    kinds = [kinds_of(seed) for seed in range(200)]
    assert {name for names in kinds for name in names} == set(KINDS)
    assert sum(not names for names in kinds) == 40
    assert sum(len(names) == 2 for names in kinds) == 40
    assert set(KINDS) <= set(CATALOGUE) <= {*KINDS, *MORE}
    assert set(QUANTITIES) == {*KINDS, *MORE, *FOREIGN}


def test_a_seed_is_one_case() -> None:
    first, again = drawn(11), drawn(11)
    assert first.outline == again.outline
    assert first.arm.drives == again.arm.drives
    assert first.shares == again.shares
    coarse = drawn(11, coarser=3.0)
    np.testing.assert_allclose(coarse.arm.of("count"), 3.0 * first.arm.of("count"))
    # joints of whole arms
    assert {outlined(seed, whole=True).n for seed in range(20)} == {5, 6, 7}
    outlines = [outlined(seed) for seed in range(100)]
    flows = {"late", "early", "step_late", "step_early", "single"}
    assert {each.flow for each in outlines} == flows
    assert {each.label for each in outlines} == {"drawn", *PUBLISHED}
    assert 30 < sum(each.imus for each in outlines) < 60
    assert {each.n for each in outlines} == {1, 2, 3, MANY}
    for each in outlines:
        assert not COMES_LATER & set(each.kinds) or each.flow in ("late", "step_late")


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"findings": [finding("stribeck")]}, "right"),
        ({"findings": [finding("stribeck", "j1")]}, "silent"),
        ({"findings": [finding("presliding_hysteresis", alike=["stribeck"])]}, "alike"),
        ({"findings": [finding("presliding_hysteresis")]}, "family"),
        ({"findings": [finding("payload", "")]}, "other"),
        ({"findings": [finding("stribeck", "j1")], "joints": ["j2 j1"]}, "right"),
        ({"unexplained": [["j2", ["velocity"]]]}, "quantity"),
        ({"unexplained": [["j2", ["position", "direction"]]]}, "quantity"),
        (
            {"unexplained": [["j2", ["position", "direction"]]], "flow": "single"},
            "silent",
        ),
        ({"unexplained": [["j2", ["time"]]]}, "other"),
        ({"residuals": {"j2": [0.11, 0.1, 0.1], "j1": [0.9, 0.1, 0.9]}}, "little left"),
        ({"residuals": {"j2": [0.3, 0.1, 0.11]}}, "little left"),
        (
            {"findings": [finding("position_dependent_friction")], "flow": "single"},
            "silent",
        ),
    ],
)
def test_an_answer_is_worth_its_best_part(
    changed: dict[str, Any], expected: str
) -> None:
    assert label(answer(**changed), 0) == expected


def test_the_name_of_one_effect_is_no_answer_about_the_other() -> None:
    both = {
        "kinds": ["stribeck", "spring"],
        "joints": ["j2", "j2"],
        "shares": [0.1, 0.1],
    }
    row = answer(findings=[finding("stribeck")], **both)
    assert [label(row, k) for k in range(2)] == ["right", "silent"]
    row = answer(findings=[finding("stribeck"), finding("torque_bias")], **both)
    assert [label(row, k) for k in range(2)] == ["right", "family"]


def test_a_wrong_name_counts_where_it_is_sure() -> None:
    assert surely_wrong(answer(findings=[finding("payload", "")]))
    assert not surely_wrong(answer(findings=[finding("payload", "", 0.5)]))
    assert not surely_wrong(answer(findings=[finding("presliding_hysteresis")]))
    clean = answer(kinds=[], joints=[], shares=[])
    assert silent(clean)
    assert not silent(clean | {"unexplained": [["j1", ["position", "direction"]]]})
    assert silent(
        clean | {"unexplained": [["j1", ["position", "direction"]]], "flow": "single"}
    )


def test_a_case_goes_the_way_of_a_user_and_is_kept(tmp_path: Path) -> None:
    """Seed 5 is clean, one log of a drawn arm: recorded, identified,
    diagnosed, cached.
    """
    (row,) = answers([5], tmp_path)
    assert row["error"] == ""
    assert (row["kinds"], row["flow"]) == ([], "single")
    assert set(row["residuals"]) == {"j1", "j2"}
    kept = {"seed": 5, "kept": True}
    (tmp_path / "outside.jsonl").write_text(json.dumps(("5", "", kept)) + "\n")
    assert answers([5], tmp_path) == [kept]
