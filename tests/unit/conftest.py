"""Simulated robots and studies do not change with the package: `make test` leaves them
out.
"""

from collections.abc import Sequence
from pathlib import Path

import pytest

APART = [Path(__file__).parent / name for name in ("plants", "studies")]


def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    """Mark all tests of these folders."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in APART):
            item.add_marker(pytest.mark.slow)
