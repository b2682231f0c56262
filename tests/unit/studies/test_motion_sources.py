"""The table of motion sources: its arithmetic, its shape and its place."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.params.schema import Parameter, RigidStage
from tests.plants.robots.identified import HeldOut
from tests.studies import motion_sources
from tests.studies.motion_sources import Found, cells, largest


def parameter(name: str, unit: str) -> Parameter:
    return Parameter(name=name, value=0.0, std_error=0.0, unit=unit, joint="a", expression=name)


def test_errors_are_relative_to_the_largest_of_their_unit() -> None:
    units = ["kg m^2", "kg m^2", "kg m"]
    names = [parameter(name, unit) for name, unit in zip("abc", units, strict=True)]
    stage = RigidStage(parameters=names, condition=1.0, rank=3)
    np.testing.assert_array_equal(largest(stage, np.array([0.5, -2.0, 3.0])), [2.0, 2.0, 3.0])


def test_a_row_says_cutoffs_medians_coverage_and_held_out_errors() -> None:
    held_out = HeldOut(np.ones(2), np.array([0.5, 0.25]), np.ones(2), (20.0, 5.0, 5.0))
    row = cells(Found(np.array([1.0, -2.0, 9.0]), np.array([1.0, 1.0, 2.0]), held_out))
    assert row == ["5.0, 20", "2.0", "1.0", "67 %", "0.50, 0.25"]


def test_its_document_has_its_place() -> None:
    from tests.studies.__main__ import DOCUMENTS, LONG, STUDIES
    from tests.studies.tables import placed

    assert "motion_sources" in STUDIES
    assert "motion_sources" in LONG
    text = DOCUMENTS["motion_sources"].read_text(encoding="utf-8")
    assert "| x |" in placed(text, "motion_sources", "| x |")
    with pytest.raises(ValueError, match="once"):
        placed(text, "no_such_study", "")
    assert motion_sources.DOCUMENT.name == "motion.md"
