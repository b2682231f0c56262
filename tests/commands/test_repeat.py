"""Results repeat to the last bit: threads of BLAS, processes, order of the logs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests import ROOT
from tests.studies.repeat import SAMPLES, WAYS, Way, lines, told

RIG = SAMPLES / "one_joint"


@pytest.mark.slow
def test_files_are_equal_bit_by_bit(tmp_path: Path) -> None:
    """Threads, processes and the order all at once; the study takes them one by one."""
    threads = next(way.environment for way in WAYS if way.environment)
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    for line in lines(RIG, first, WAYS[0]):
        assert main(line) == 0
    others = list(lines(RIG, second, Way("all at once", jobs=2, reverse=True)))
    run = "import json, sys; from seqid_cli.__main__ import main\n" + (
        "for line in json.loads(sys.argv[1]): assert main(line) == 0"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **threads}
    command = [sys.executable, "-c", run, json.dumps(others)]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    names = sorted(path.name for path in first.iterdir())
    assert len(names) == 6
    assert [told(second / name) for name in names] == [told(first / name) for name in names]


def test_blas_has_one_thread_whatever_was_set(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert main(["completion", "bash"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
