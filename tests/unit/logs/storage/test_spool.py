"""Rows set aside come back as they were, or not at all."""

import shutil
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.logs.storage.temporary import Spool

Usage = namedtuple("Usage", "total used free")


def parts() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(3)
    sizes = (5, 1, 4_000)
    return [
        (rng.integers(0, 1 << 60, m), rng.normal(size=(4, m)).T if m > 1 else np.ones((m, 4)))
        for m in sizes
    ]


def test_a_full_disk_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(1 << 40, 1 << 40, 400))
    spool = Spool()
    spool.push(*parts()[-1])
    assert not spool.complete


def test_no_folder_for_temporary_files_is_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    spool = Spool()
    spool.push(*parts()[0])
    assert not spool.complete
