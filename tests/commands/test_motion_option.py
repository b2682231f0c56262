"""`--motion` on the commands that take it: what they pass on, what they say, what cannot be."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
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


@dataclass
class Bench:
    """Two simulated logs of the planar rig, a parameter file that holds its calibrations."""

    run: Callable[..., tuple[int, str, str]]
    recordings: list[Recording] = field(default_factory=list)


@pytest.fixture
def bench(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """The commands' folder with the planar rig in it; what its logs hold may be changed."""
    s = scene("two")
    (rig.folder / "robot.toml").write_text(robot_toml("two", s.plant), encoding="ascii")
    robot = load_robot(rig.folder / "robot.toml")
    write_json_atomic(rig.folder / "p.json", with_stage(None, robot_id(robot), [], imu=s.stage))
    logs = [replace(s.recording, path=Path(f"{name}.parquet"), sha256=name * 64) for name in "ab"]
    made = Bench(lambda *a: (lambda d: (d.code, d.out, d.err))(rig.run(*a)), logs)

    def read(path: Path, robot: Robot, **options: object) -> Screened:
        by_name = {str(log.path): log for log in made.recordings}
        return Screened(by_name[Path(path).name], ())

    def held(*given: object, **options: object) -> None:
        """No log is long."""

    monkeypatch.setattr("seqid_cli.identify.log_set.read_screened", read)
    monkeypatch.setattr("seqid_cli.identify.prediction.predict.open_if_long", held)
    return made


PREDICT = ("predict", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json")


def without(recording: Recording, *names: str) -> Recording:
    kept = {k: v for k, v in recording.accelerometers.items() if k not in names}
    return replace(recording, accelerometers=kept)


def test_a_prediction_says_what_motion_it_rests_on(bench: Bench) -> None:
    code, out, err = bench.run(*PREDICT, "--json")
    assert code == 0
    file = json.loads(out)
    jsonschema.validate(file, json_schema(PREDICTION_SCHEMA))
    for log in file["logs"]:
        used = log["motion"]
        assert (used["source"], used["imus"]) == ("fused", ["imu_a", "imu_b"])
        assert used["cutoff_hz"] == log["cutoff_hz"]
        for joint in ("joint_1", "joint_2"):
            assert used["acceleration_error"][joint] < 0.2 * used["encoder_error"][joint]
    assert "motion: fused (imu_a, imu_b) in 2 of 2 logs; acceleration known to 0.0" in err


def test_a_log_without_imus_falls_back_and_names_them(bench: Bench) -> None:
    bench.recordings[1] = without(bench.recordings[1], "imu_a", "imu_b")
    code, out, err = bench.run(*PREDICT, "--json")
    assert code == 0
    assert [log["motion"]["source"] for log in json.loads(out)["logs"]] == ["fused", "encoder"]
    assert "warning: b.parquet: imu_a is not recorded" in err
    assert "warning: b.parquet: imu_b is not recorded" in err
    assert "fused (imu_a, imu_b) in 1 of 2 logs, encoder in 1 of 2 logs" in err


@pytest.mark.parametrize("source", ["imu", "fused"])
def test_insisting_on_imus_that_are_not_there_cannot_be(bench: Bench, source: str) -> None:
    bench.recordings[1] = without(bench.recordings[1], "imu_a", "imu_b")
    code, _, err = bench.run(*PREDICT, "--motion", source)
    assert code == 2
    assert f"b.parquet: no calibrated, healthy IMU for --motion {source}" in err
    assert "imu_a is not recorded" in err
    assert "use --motion encoder" in err


def test_the_same_warning_of_many_logs_is_one_line(bench: Bench) -> None:
    bench.recordings[:] = [without(log, "imu_b") for log in bench.recordings]
    _, _, err = bench.run(*PREDICT)
    assert err.count("imu_b is not recorded") == 1
    assert "imu_b is not recorded (2 of 2 logs)" in err


def test_a_simultaneous_fit_says_its_motion(bench: Bench) -> None:
    command = ("simultaneous", *PREDICT[1:], "--json", "-o", "out.json")
    code, out, err = bench.run(*command)
    assert code == 0
    file = json.loads(out)
    jsonschema.validate(file, json_schema(SCHEMA))
    used = file["stages"]["inertia"]["motion_use"]
    assert [use["source"] for use in used] == ["fused", "fused"]
    assert file["stages"]["inertia"]["motion"]["a.parquet"] == "fused: imu_a, imu_b"
    assert [use["cutoff_hz"] for use in used] == [file["stages"]["inertia"]["cutoff_hz"]] * 2
    assert "motion: fused" in err
    assert file["stages"]["imu"]
    assert file["stages"].get("gravity") is None
