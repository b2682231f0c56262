"""The arms that every form is tested with."""

from pathlib import Path

import pytest

from tests.unit.export.arms import ARMS, Arm


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Arm:
    return ARMS[request.param](tmp_path)
