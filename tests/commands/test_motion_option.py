"""`--motion` on the commands that take it: what they pass on, what they say, what cannot be."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from seqid_cli.inspect.screening import Screened
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.commands.conftest import Reader, Rig
from tests.plants.robotfile import robot_toml
from tests.unit.motion.smoother.rigs import scene
from tests.unit.params.documents import full_file
from tests.unit.params.generate import json_schema

LOGS = ["a.parquet", "-r", "robot.toml"]


@pytest.mark.parametrize("source", ["imu", "fused"])
@pytest.mark.parametrize("command", ["inertia", "predict", "diagnose", "simultaneous"])
def test_imus_need_their_calibration(rig: Rig, reader: Reader, command: str, source: str) -> None:
    file = full_file()
    file.stages.imu = None
    before = rig.params("p.json", file)
    given = [] if command == "simultaneous" else ["-p", before]
    done = rig.run(command, *LOGS, *given, "--motion", source)
    assert done.code == 2
    assert "there is no imu stage" in done.err
    assert "seqid imu-calib" in done.err


@pytest.fixture
def recordings(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """Two simulated logs of the planar rig, which may be changed; its calibrations lie beside."""
    s = scene("two")
    (rig.folder / "robot.toml").write_text(robot_toml("two", s.plant), encoding="ascii")
    robot = load_robot(rig.folder / "robot.toml")
    write_json_atomic(rig.folder / "p.json", with_stage(None, robot_id(robot), [], imu=s.stage))
    logs = [replace(s.recording, path=Path(f"{name}.parquet"), sha256=name * 64) for name in "ab"]

    def read(path: Path, robot: Robot, **options: object) -> Screened:
        return Screened(next(log for log in logs if log.path.name == Path(path).name), ())

    monkeypatch.setattr("seqid_cli.identify.log_set.read_screened", read)
    # No log is long.
    monkeypatch.setattr("seqid_cli.identify.prediction.predict.open_if_long", lambda *_, **__: None)
    return logs


PREDICT = ("predict", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json")


def without(recording: Recording, *names: str) -> Recording:
    kept = {k: v for k, v in recording.accelerometers.items() if k not in names}
    return replace(recording, accelerometers=kept)


def test_a_prediction_says_what_motion_it_rests_on(rig: Rig, recordings: list[Recording]) -> None:
    done = rig.run(*PREDICT, "--json")
    assert done.code == 0
    file = json.loads(done.out)
    jsonschema.validate(file, json_schema(PREDICTION_SCHEMA))
    for log in file["logs"]:
        used = log["motion"]
        assert (used["source"], used["imus"]) == ("fused", ["imu_a", "imu_b"])
        assert used["cutoff_hz"] == log["cutoff_hz"]
        for joint in ("joint_1", "joint_2"):
            assert used["acceleration_error"][joint] < 0.2 * used["encoder_error"][joint]
    assert "motion: fused (imu_a, imu_b) in 2 of 2 logs; acceleration known to 0.0" in done.err


def test_a_log_without_imus_falls_back_and_names_them(
    rig: Rig, recordings: list[Recording]
) -> None:
    recordings[1] = without(recordings[1], "imu_a", "imu_b")
    done = rig.run(*PREDICT, "--json")
    assert done.code == 0
    assert [log["motion"]["source"] for log in json.loads(done.out)["logs"]] == ["fused", "encoder"]
    assert "warning: b.parquet: imu_a is not recorded" in done.err
    assert "warning: b.parquet: imu_b is not recorded" in done.err
    assert "fused (imu_a, imu_b) in 1 of 2 logs, encoder in 1 of 2 logs" in done.err


@pytest.mark.parametrize("source", ["imu", "fused"])
def test_insisting_on_imus_that_are_not_there_cannot_be(
    rig: Rig, recordings: list[Recording], source: str
) -> None:
    recordings[1] = without(recordings[1], "imu_a", "imu_b")
    done = rig.run(*PREDICT, "--motion", source)
    assert done.code == 2
    assert f"b.parquet: no calibrated, healthy IMU for --motion {source}" in done.err
    assert "imu_a is not recorded" in done.err
    assert "use --motion encoder" in done.err


def test_the_same_warning_of_many_logs_is_one_line(rig: Rig, recordings: list[Recording]) -> None:
    recordings[:] = [without(log, "imu_b") for log in recordings]
    done = rig.run(*PREDICT)
    assert done.err.count("imu_b is not recorded") == 1
    assert "imu_b is not recorded (2 of 2 logs)" in done.err


def test_a_simultaneous_fit_says_its_motion(rig: Rig, recordings: list[Recording]) -> None:
    command = ("simultaneous", *PREDICT[1:], "--json", "-o", "out.json")
    done = rig.run(*command)
    assert done.code == 0
    file = json.loads(done.out)
    jsonschema.validate(file, json_schema(SCHEMA))
    used = file["stages"]["inertia"]["motion_use"]
    assert [use["source"] for use in used] == ["fused", "fused"]
    assert file["stages"]["inertia"]["motion"]["a.parquet"] == "fused: imu_a, imu_b"
    assert [use["cutoff_hz"] for use in used] == [file["stages"]["inertia"]["cutoff_hz"]] * 2
    assert "motion: fused" in done.err
    assert file["stages"]["imu"]
    assert file["stages"].get("gravity") is None
