"""Results repeat to the last bit: threads of BLAS, processes, order of the logs."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests import ROOT

RIG = ROOT / "sample_logs" / "one_joint"
OF_THE_RUN = ("created", "parameters")


def lines(rig: Path, out: Path, *, jobs: int, reverse: bool) -> Iterator[list[str]]:
    """Command lines from the logs of a rig to prediction and diagnosis."""
    robot, before = ["-r", str(rig / "robot.toml")], list[str]()
    stages = ("friction", "gravity", "imu-calib", "inertia", "predict", "diagnose")
    folders = ("friction", "gravity", "imu", "inertia", "validation", "validation")
    for stage, folder in zip(stages, folders, strict=True):
        logs = sorted(map(str, (rig / folder).glob("*.*")), reverse=reverse)
        if stage == "gravity" and not logs:  # it has nothing to identify there
            logs = sorted(map(str, (rig / "friction").glob("*.*")), reverse=reverse)
        if not logs:
            continue
        made = out / f"{stage}.json"
        many = [] if stage == "diagnose" else ["--jobs", str(jobs)]
        yield [stage, *logs, *robot, *before, *many, "-o", str(made)]
        before = before if stage == "predict" else ["-p", str(made)]


def told(path: Path) -> str:
    """What a file says, apart from when it and the models that it used were made."""
    document = json.loads(path.read_text("utf-8").replace(str(path.parent), ""))
    return json.dumps({key: own for key, own in document.items() if key not in OF_THE_RUN})


@pytest.mark.slow
def test_files_are_equal_bit_by_bit(tmp_path: Path) -> None:
    """Threads, processes and the order all at once."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    for line in lines(RIG, first, jobs=1, reverse=False):
        assert main(line) == 0
    others = list(lines(RIG, second, jobs=2, reverse=True))
    run = "import json, sys; from seqid_cli.__main__ import main\n" + (
        "for line in json.loads(sys.argv[1]): assert main(line) == 0"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "2"}
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
