"""Held-out logs are opened after the last decision: until then there is nothing in them to read."""

import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement import rounds as deciding
from seqid_cli.discover.refinement.loop import Refinement
from seqid_cli.logs.recording import Recording
from seqid_cli.params.io import read_parameters, write_json_atomic
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.robot.types import Robot
from tests import ROOT

SAMPLES = ROOT / "sample_logs" / "one_joint"
HELD_OUT = "held_out.parquet"
Opened = list[str]


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Every file that Python opens, by its name."""
    names: Opened = []
    listening = True

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if listening and event == "open" and isinstance(arguments[0], str | bytes | Path):
            names.append(Path(str(arguments[0])).name)

    sys.addaudithook(hook)  # stays for good: switched off below
    yield names
    listening = False


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Logs to fit, a robot and a model that names the held-out log as one of its own."""
    monkeypatch.chdir(tmp_path)
    for name in ("robot.toml", "changed/fourier.parquet"):
        shutil.copy(SAMPLES / name, tmp_path)
    for urdf in SAMPLES.glob("*.urdf"):
        shutil.copy(urdf, tmp_path)
    file = read_parameters(SAMPLES / "golden.json")
    own = InputLog(path=HELD_OUT, sha256="0" * 64, samples=1, stage="inertia")
    file.inputs = [*file.inputs, own]
    write_json_atomic(tmp_path / "p.json", file)
    (tmp_path / HELD_OUT).write_bytes(b"not a log yet")
    return tmp_path


def call(*more: str) -> int:
    names = ["fourier.parquet", "--holdout", HELD_OUT, "-r", "robot.toml", "-p", "p.json"]
    return main(["refine", *names, "-o", "out.json", *more])


def test_held_out_logs_are_opened_after_the_last_decision(
    folder: Path, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    decided: Opened = []

    def refine(
        training: Sequence[Recording],
        robot: Robot,
        file: ParameterFile,
        *,
        earlier: Mapping[str, Sequence[Recording]],
        options: DiscoverOptions,
    ) -> Refinement:
        found = decide(training, robot, file, earlier=earlier, options=options)
        decided.extend(opened)
        shutil.copy(SAMPLES / "changed" / HELD_OUT, folder / HELD_OUT)  # now it is recorded
        return found

    decide = deciding.refine
    monkeypatch.setattr(deciding, "refine", refine)
    assert call() == 0
    assert "fourier.parquet" in decided
    assert HELD_OUT not in decided
    loop = json.loads((folder / "out.json").read_text())["closed_loop"]
    assert loop["evaluated_on"] == [HELD_OUT]
    assert any("held out, although" in note for note in loop["notes"])


@pytest.mark.slow
def test_a_held_out_log_that_cannot_be_read_is_only_found_out_then(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call() == 2
    assert HELD_OUT in capsys.readouterr().err
    assert not (folder / "out.json").exists()
