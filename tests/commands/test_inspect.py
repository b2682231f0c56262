"""`seqid inspect` as its user meets it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from seqid_cli.params.encode import encode
from seqid_cli.params.results.inspection import INSPECTION_SCHEMA, InspectionFile
from tests.commands.conftest import Rig
from tests.commands.transcripts import check_transcript
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

TWO = SAMPLES / "two_joint"
Columns = dict[str, np.ndarray]


def copy(folder: Path, log: str, name: str | None = None) -> str:
    target = name or Path(log).name
    shutil.copy(TWO / log, folder / target)
    shutil.copy(TWO / "robot.toml", folder / "robot.toml")
    return target


def edited(folder: Path, log: str, change: Callable[[Columns], Columns]) -> str:
    """Copy a log with other columns."""
    name = copy(folder, log)
    write_columns(folder / name, change(read_columns(folder / name)))
    return name


def in_degrees(columns: Columns) -> Columns:
    return columns | {"joint_2.position": 57.29578 * columns["joint_2.position"]}


def without_names(columns: Columns) -> Columns:
    names = {"joint_1.position": "q_0", "joint_2.position": "q_1"}
    names |= {"joint_1.current": "i_0", "joint_2.current": "i_1"}
    return {names.get(name, name): values for name, values in columns.items()}


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])


def test_what_the_user_sees(rig: Rig) -> None:
    """A good log, one in degrees, one cut short, a copy, one that cannot be read, other names."""
    folder = rig.folder
    copy(folder, "imu/joint_2.mcap")
    copy(folder, "imu/joint_2.mcap", "short.mcap")
    cut(folder / "short.mcap")
    copy(folder, "validation/point_to_point.parquet")
    copy(folder, "validation/point_to_point.parquet", "point_to_point_again.parquet")
    (folder / "broken.parquet").write_bytes(b"PAR1 and no more")
    edited(folder, "validation/fourier_1.parquet", in_degrees)
    text = (folder / "robot.toml").read_text()
    (folder / "other.toml").write_text(text.replace('"joint_2"', '"joint2"'))
    check_transcript(rig, "inspect")


def test_json_is_one_document_and_the_file_the_same(rig: Rig) -> None:
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
    log = edited(rig.folder, "validation/fourier_1.parquet", in_degrees)
    (rig.folder / "broken.parquet").write_bytes(b"PAR1 and no more")
    done = rig.run("inspect", log, "broken.parquet", "-r", "robot.toml", "--json")
    assert done.code == 2
    document = json.loads(done.out)
    finding = next(x for x in document["findings"] if x["log"] == log)
    keys = {"code", "severity", "log", "joint", "channel", "message", "remedy"}
    assert set(finding) == keys
    assert (finding["code"], finding["joint"]) == ("position_in_degrees", "joint_2")
    assert finding["severity"] == "error"
    assert [entry["verdict"] for entry in document["logs"]] == ["unreadable", "faulty"]


def test_a_fault_of_many_logs_is_told_once(rig: Rig) -> None:
    columns = read_columns(TWO / "validation" / "fourier_1.parquet")
    (rig.folder / "logs").mkdir()
    for k in range(16):
        some = {name: values[10 * k : 1000 + 10 * k] for name, values in columns.items()}
        for joint in ("joint_1", "joint_2"):
            some[f"{joint}.position"] = 57.29578 * some[f"{joint}.position"]
        write_columns(rig.folder / f"logs/log_{k}.parquet", some)
    check_transcript(rig, "inspect_many")
    every = rig.run("inspect", "logs", "-v").out
    assert sum(line.startswith("error") for line in every.splitlines()) == 32


def test_without_a_robot_file_the_joints_are_guessed(rig: Rig) -> None:
    log = edited(rig.folder, "validation/fourier_1.parquet", without_names)
    done = rig.run("inspect", log, "--json")
    assert done.code == 0
    (entry,) = json.loads(done.out)["logs"]
    assert [joint["name"] for joint in entry["joints"]] == ["joint_1", "joint_2"]
    assert {joint["effort"] for joint in entry["joints"]} == {"current"}
    assert entry["joints"][0]["encoder_step"] == pytest.approx(0.0104719755, rel=1e-6)
