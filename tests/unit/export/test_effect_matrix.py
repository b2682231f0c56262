"""Exported code is as good as its file, whatever the effect and the arm.

The study runs all of it; here are the effects that stateful code has to say.
"""

import pytest

from seqid_cli.export.written.code import compiler
from tests.studies.exported_effects import (
    ARMS,
    MAX_RATIO,
    PACKAGE,
    SUBJECTS,
    package_installed,
    planted,
    replays,
)

REMEMBERING = ("time_skew", "actuator_lag", "joint_elasticity", "backlash", PACKAGE)
SECONDS = 3.0
LEFT_OUT = 3.0  # times the file's error, of a header that lacks the effect
needs_cc = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


@pytest.mark.parametrize("arm", ARMS)
def test_every_effect_has_a_place(arm: str) -> None:
    with package_installed():
        without = {name for name in SUBJECTS if not planted(name, arm).items}
    assert without == ({"transmission_coupling"} if arm == "one_joint" else set())


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("subject", REMEMBERING)
def test_exported_code_is_as_good_as_its_file(subject: str) -> None:
    (found,) = replays(subject, "six_joint", forms=["C header"], seconds=SECONDS)
    assert found.ratio is not None
    assert found.left_out is not None
    assert found.ratio <= MAX_RATIO
    assert found.left_out > LEFT_OUT
