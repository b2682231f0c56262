"""`seqid inspect` as its user meets it."""

import json
import shutil
from pathlib import Path

import pytest

from seqid_cli.params.encode import encode
from seqid_cli.params.results.inspection import INSPECTION_SCHEMA, InspectionFile
from tests.commands.conftest import Rig
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

TWO = SAMPLES / "two_joint"


def copy(folder: Path, log: str, name: str | None = None) -> str:
    target = name or Path(log).name
    shutil.copy(TWO / log, folder / target)
    shutil.copy(TWO / "robot.toml", folder / "robot.toml")
    return target


def test_the_verdict_comes_first(rig: Rig) -> None:
    log = copy(rig.folder, "imu/joint_2.mcap")
    done = rig.run("inspect", log, "-r", "robot.toml")
    assert done.code == 0
    assert done.out.splitlines()[0] == "verdict: good - nothing wrong was found (1 log)"
    for text in ("joint_2.mcap", "mcap", "imu-calib", "imu_b", "ms after the header stamp"):
        assert text in done.out
    assert "Traceback" not in done.err


def test_json_is_one_document_and_the_file_the_same(rig: Rig) -> None:
    import msgspec

    log = copy(rig.folder, "imu/joint_2.mcap")
    done = rig.run("inspect", log, "-r", "robot.toml", "--json", "-o", "found.json")
    assert done.code == 0
    document = json.loads(done.out)
    assert document["schema"] == INSPECTION_SCHEMA
    assert document["findings"] == []
    assert document["logs"][0]["serves"] == ["imu-calib"]
    assert [joint["moves"] for joint in document["logs"][0]["joints"]] == [False, True]
    assert (rig.folder / "found.json").read_text() == done.out
    file = msgspec.json.decode(done.out, type=InspectionFile)
    assert encode(file) == done.out


def test_findings_have_all_their_keys_and_errors_count(rig: Rig) -> None:
    log = copy(rig.folder, "validation/fourier_1.parquet")
    columns = read_columns(rig.folder / log)
    columns["joint_2.position"] *= 57.29578
    write_columns(rig.folder / log, columns)
    done = rig.run("inspect", log, "-r", "robot.toml", "--json")
    assert done.code == 1
    document = json.loads(done.out)
    (finding,) = document["findings"]
    keys = {"code", "severity", "log", "joint", "channel", "message", "remedy"}
    assert set(finding) == keys
    assert (finding["code"], finding["joint"]) == ("position_in_degrees", "joint_2")
    assert (finding["log"], finding["severity"]) == (log, "error")
    assert document["verdict"] == "faulty"


def test_a_log_that_cannot_be_read_does_not_hide_the_others(rig: Rig) -> None:
    log = copy(rig.folder, "validation/fourier_1.parquet")
    (rig.folder / "broken.parquet").write_bytes(b"PAR1 and no more")
    done = rig.run("inspect", "broken.parquet", log, "-r", "robot.toml", "--json")
    assert done.code == 2
    assert "broken.parquet" in done.err
    document = json.loads(done.out)
    assert [entry["verdict"] for entry in document["logs"]] == ["unreadable", "good"]


def test_a_log_cut_short_is_read_in_part(rig: Rig) -> None:
    log = copy(rig.folder, "imu/joint_2.mcap")
    data = (rig.folder / log).read_bytes()
    (rig.folder / log).write_bytes(data[: int(0.7 * len(data))])
    done = rig.run("inspect", log, "-r", "robot.toml", "--json")
    assert done.code == 3
    document = json.loads(done.out)
    assert "salvaged" in {finding["code"] for finding in document["findings"]}
    assert document["logs"][0]["partial"]


def test_names_that_do_not_fit_are_told_with_the_nearest(rig: Rig) -> None:
    log = copy(rig.folder, "friction/joint_1.parquet")
    text = (rig.folder / "robot.toml").read_text()
    (rig.folder / "robot.toml").write_text(text.replace('"joint_2"', '"joint2"'))
    done = rig.run("inspect", log, "-r", "robot.toml", "--json")
    document = json.loads(done.out)
    assert document["logs"][0]["missing"] == {"joint2": "joint_2"}
    assert {finding["code"] for finding in document["findings"]} == {"channel_missing"}
    assert document["logs"][0]["rate_hz"] == pytest.approx(250.0)


def test_a_fault_of_many_logs_is_told_once(rig: Rig) -> None:
    log = copy(rig.folder, "validation/fourier_1.parquet")
    columns = read_columns(rig.folder / log)
    (rig.folder / "logs").mkdir()
    for k in range(16):
        some = {name: values[10 * k : 1000 + 10 * k] for name, values in columns.items()}
        for joint in ("joint_1", "joint_2"):
            some[f"{joint}.position"] = 57.29578 * some[f"{joint}.position"]
        write_columns(rig.folder / f"logs/log_{k}.parquet", some)
    done = rig.run("inspect", "logs")
    assert done.code == 1
    (finding,) = [line for line in done.out.splitlines() if line.startswith("error")]
    assert "(and 15 more logs): joint_1, joint_2: position: moves at" in finding
    assert "log_0.parquet and 15 more  faulty" in done.out
    every = rig.run("inspect", "logs", "-v").out
    assert sum(line.startswith("error") for line in every.splitlines()) == 32


def test_the_same_log_twice_is_told(rig: Rig) -> None:
    first = copy(rig.folder, "validation/point_to_point.parquet")
    second = copy(rig.folder, "validation/point_to_point.parquet", "point_to_point_again.parquet")
    done = rig.run("inspect", first, second, "-r", "robot.toml", "--json")
    (finding,) = json.loads(done.out)["findings"]
    assert (finding["code"], finding["log"]) == ("duplicate_log", second)


def test_without_a_robot_file_the_joints_are_guessed(rig: Rig) -> None:
    log = copy(rig.folder, "validation/fourier_1.parquet")
    columns = read_columns(rig.folder / log)
    renamed = {
        name.replace("joint_1.position", "q_0")
        .replace("joint_2.position", "q_1")
        .replace("joint_1.current", "i_0")
        .replace("joint_2.current", "i_1"): values
        for name, values in columns.items()
    }
    write_columns(rig.folder / log, renamed)
    done = rig.run("inspect", log, "--json")
    assert done.code == 0
    (entry,) = json.loads(done.out)["logs"]
    assert [joint["name"] for joint in entry["joints"]] == ["joint_1", "joint_2"]
    assert {joint["effort"] for joint in entry["joints"]} == {"current"}
    assert entry["joints"][0]["encoder_step"] == pytest.approx(0.0104719755, rel=1e-6)
