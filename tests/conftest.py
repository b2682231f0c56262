"""Tests read what commands write to a pipe: workers of pytest say they were a screen's
width. Files with slow tests come first.
"""

from __future__ import annotations

import os

import pytest

os.environ.pop("COLUMNS", None)


@pytest.hookimpl(trylast=True)  # tests are marked by then
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with files that have slow tests.

    A file stays with one worker: a dear one that comes last leaves the others idle.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
