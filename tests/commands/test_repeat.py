"""Results repeat to the last bit: threads of BLAS, processes, order of the logs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests.studies.repeat import SAMPLES, WAYS, Way, made_by

RIG = SAMPLES / "one_joint"


@pytest.mark.slow
def test_files_are_equal_bit_by_bit(tmp_path: Path) -> None:
    """Threads, processes and the order all at once; the study takes them one by one."""
    threads = next(way.environment for way in WAYS if way.environment)
    all_at_once = Way("all at once", environment=threads, jobs=2, reverse=True)
    first, second = (
        made_by(way, RIG, tmp_path / name)
        for way, name in ((WAYS[0], "first"), (all_at_once, "second"))
    )
    assert len(first) == 6
    assert second == first


def test_blas_has_one_thread_whatever_was_set(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert main(["completion", "bash"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
