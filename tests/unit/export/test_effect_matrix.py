"""Exported code is as good as its file, whatever the effect and the arm."""

import pytest

from seqid_cli.export.written import compiler
from seqid_cli.model.effects.registry import CATALOGUE
from tests.studies.exported_effects import ARMS, MAX_RATIO, effects_of, replays
from tests.unit.export.arms import sample

needs_cc = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


@pytest.mark.parametrize("arm", ARMS)
def test_every_effect_has_a_place(arm: str) -> None:
    robot, _ = sample(arm)
    without = {name for name in CATALOGUE if not effects_of(name, robot)}
    assert without == ({"transmission_coupling"} if arm == "one_joint" else set())


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("arm", ["one_joint", "six_joint"])
@pytest.mark.parametrize("name", CATALOGUE)
def test_exported_code_is_as_good_as_its_file(name: str, arm: str) -> None:
    """In C; the study runs the numpy module as well."""
    for found in replays(name, arm, forms=["C header"]):
        assert found.ratio is None or found.ratio <= MAX_RATIO
