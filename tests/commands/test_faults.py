"""Killed while they write, or on a full disk: old files stay whole, no litter after a run."""

from pathlib import Path

import pytest

from tests.commands.torment import COMMANDS, torment


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("friction", 1),
        ("trend", 2),
        pytest.param("predict, MCAP", 2, marks=pytest.mark.slow),
        pytest.param("predict", 2, marks=pytest.mark.slow),
        pytest.param("report", 1, marks=pytest.mark.slow),
    ],
)
def test_old_files_stay_whole(name: str, files: int, tmp_path: Path) -> None:
    forks = torment(COMMANDS[name], tmp_path, kills=12, points=6)
    assert not forks.wrong
    assert len(forks.sizes) == files
    assert forks.killed >= 10
    assert forks.inside
    assert forks.full >= 6  # one a file at least
