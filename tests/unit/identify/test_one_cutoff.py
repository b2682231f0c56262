"""One cut-off per identification: chosen over all logs, and carried by the file."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.commands.app import run
from seqid_cli.errors import InputError
from seqid_cli.identify.common_cutoff import identification_options
from seqid_cli.identify.options import RigidOptions
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.unit.identify.test_lost_samples import ROBOT, write_log

SAMPLES = ROOT / "sample_logs" / "six_joint"
LOGS = sorted((SAMPLES / "inertia").glob("*.parquet"))


def test_the_order_of_the_logs_does_not_matter() -> None:
    robot = load_robot(SAMPLES / "robot.toml")
    first = identification_options(LOGS[:3], robot, RigidOptions(source="encoder"))
    other = identification_options(LOGS[2::-1], robot, RigidOptions(source="encoder"))
    assert first == other
    assert "3 logs together" in first.origin


def test_later_commands_take_the_files_cutoff(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.toml").write_text(ROBOT)
    logs = [write_log(tmp_path / f"{k}.parquet", rate, 0, k) for k, rate in enumerate((250, 1000))]
    robot, out = ["-r", str(tmp_path / "robot.toml")], tmp_path / "model.json"
    assert run(["simultaneous", *map(str, logs), *robot, "-o", str(out)]) == 0
    stages = msgspec.json.decode(out.read_bytes(), type=ParameterFile).stages
    assert len({use.cutoff_hz for use in stages.inertia.motion_use}) == 1
    assert stages.friction.cutoff_hz == stages.inertia.cutoff_hz
    for given, hz in (([], stages.inertia.cutoff_hz), (["--cutoff", "7"], 7.0)):
        arguments = [*robot, "-p", str(out), "-o", str(tmp_path / "prediction.json"), *given]
        assert run(["predict", *map(str, logs), *arguments]) == 0
        text = (tmp_path / "prediction.json").read_bytes()
        file = msgspec.json.decode(text, type=PredictionFile)
        assert [log.cutoff_hz for log in file.logs] == [hz, hz]
        assert file.cutoff_origin == ("as given" if given else "of the inertia stage")
        assert "cut-off: " in capsys.readouterr().err


def test_a_log_too_slow_for_the_models_cutoff_says_what_it_allows(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(ROBOT)
    robot = load_robot(tmp_path / "robot.toml")
    log = write_log(tmp_path / "fast.parquet", 250.0, 0, 1)
    slow = pq.read_table(log)
    pq.write_table(slow.take(np.arange(0, len(slow), 10)), tmp_path / "slow.parquet")
    recording = read_recording(tmp_path / "slow.parquet", robot)
    options = MotionOptions(12.0, origin="of the inertia stage")
    with pytest.raises(InputError, match=r"the highest that this log allows is 6.25 Hz"):
        estimate_motion(recording, robot, options)
    assert estimate_motion(recording, robot, MotionOptions(6.0, origin=options.origin)).samples
