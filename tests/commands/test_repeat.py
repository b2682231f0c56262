"""Results repeat to the last bit: threads of BLAS, processes, order of the logs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests.studies.repeat import SAMPLES, WAYS, Way, made_by

RIG = SAMPLES / "one_joint"


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return made_by(WAYS[0], RIG, tmp_path_factory.mktemp("first") / "out")


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
def test_files_are_equal_bit_by_bit(way: Way, first: dict[str, str], tmp_path: Path) -> None:
    assert len(first) == 6
    assert made_by(way, RIG, tmp_path / "out") == first


def test_blas_has_one_thread_whatever_was_set(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert main(["completion", "bash"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
