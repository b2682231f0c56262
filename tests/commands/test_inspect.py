"""`seqid inspect` as its user meets it, and the stages, which say of a log what it
says.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from pyarrow import csv

from seqid_cli.inspect.findings import ERRORS
from seqid_cli.params.encode import encode
from seqid_cli.params.results.inspection import INSPECTION_SCHEMA, InspectionFile
from tests.commands.conftest import ONE_JOINT, SAMPLE_LOGS, Rig
from tests.unit.inspect.faults import read_columns, write_columns

TWO = SAMPLE_LOGS / "two_joint"
Columns = dict[str, np.ndarray]


def copy(folder: Path, log: str, name: str | None = None) -> str:
    target = name or Path(log).name
    shutil.copy(TWO / log, folder / target)
    shutil.copy(TWO / "robot.toml", folder / "robot.toml")
    return target


def edited(folder: Path, log: str, change: Callable[[Columns], Columns]) -> str:
    name = copy(folder, log)
    write_columns(folder / name, change(read_columns(folder / name)))
    return name


def in_degrees(columns: Columns) -> Columns:
    return columns | {"joint_2.position": 57.29578 * columns["joint_2.position"]}


def test_what_the_user_sees(rig: Rig) -> None:
    """A good log, one in degrees, one cut short, a copy, one that cannot be read, other
    names.
    """
    folder = rig.folder
    copy(folder, "imu/joint_2.mcap")
    whole = (TWO / "imu" / "joint_2.mcap").read_bytes()
    (folder / "short.mcap").write_bytes(whole[: int(0.7 * len(whole))])
    copy(folder, "validation/point_to_point.parquet")
    copy(folder, "validation/point_to_point.parquet", "point_to_point_again.parquet")
    (folder / "broken.parquet").write_bytes(b"PAR1 and no more")
    edited(folder, "validation/fourier_1.parquet", in_degrees)
    text = (folder / "robot.toml").read_text()
    (folder / "other.toml").write_text(text.replace('"joint_2"', '"joint2"'))
    rig.check_transcript("inspect")


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


def test_a_fault_of_many_logs_is_told_once(rig: Rig) -> None:
    (rig.folder / "robot.toml").unlink()
    columns = read_columns(TWO / "validation" / "fourier_1.parquet")
    (rig.folder / "logs").mkdir()
    for k in range(16):
        some = {
            name: values[10 * k : 1000 + 10 * k] for name, values in columns.items()
        }
        for joint in ("joint_1", "joint_2"):
            some[f"{joint}.position"] = 57.29578 * some[f"{joint}.position"]
        write_columns(rig.folder / f"logs/log_{k}.parquet", some)
    rig.check_transcript("inspect_many")
    every = rig.run("inspect", "logs", "-v").out
    assert sum(line.startswith("error") for line in every.splitlines()) == 32


def test_a_robot_file_is_found_where_none_is_given(rig: Rig) -> None:
    done = rig.run("inspect", str(TWO / "validation" / "fourier_1.parquet"), "-v")
    assert "robot file: robot.toml (-r names another)" in done.err
    (rig.folder / "robot.toml").unlink()
    done = rig.run("inspect", str(TWO / "validation" / "fourier_1.parquet"), "-v")
    assert "two_joint/robot.toml (beside the logs; -r names another)" in done.err


def test_without_a_robot_file_the_joints_are_guessed(rig: Rig) -> None:
    (rig.folder / "robot.toml").unlink()
    names = {"joint_1.position": "q_0", "joint_2.position": "q_1"}
    names |= {"joint_1.current": "i_0", "joint_2.current": "i_1"}
    log = edited(
        rig.folder,
        "validation/fourier_1.parquet",
        lambda columns: {
            names.get(name, name): values for name, values in columns.items()
        },
    )
    done = rig.run("inspect", log, "--json")
    assert done.code == 0
    (entry,) = json.loads(done.out)["logs"]
    assert [joint["name"] for joint in entry["joints"]] == ["joint_1", "joint_2"]
    assert {joint["effort"] for joint in entry["joints"]} == {"current"}
    assert entry["joints"][0]["encoder_step"] == pytest.approx(0.0104719755, rel=1e-6)


TRIAL = ONE_JOINT / "friction" / "joint_1.parquet"
ROBOT = ("-r", str(ONE_JOINT / "robot.toml"))


def hole(values: np.ndarray) -> None:
    values[300:420] = np.nan


def spike(values: np.ndarray) -> None:
    values[len(values) // 2] += 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "code"),
    [
        ("joint_1.position", hole, "channel_hole"),
        ("joint_1.current", hole, "channel_hole"),
        pytest.param(
            "joint_1.position", spike, "position_spikes", marks=pytest.mark.slow
        ),
    ],
)
def test_a_stage_says_it_too(
    rig: Rig, name: str, change: Callable[[np.ndarray], None], code: str
) -> None:
    columns = read_columns(TRIAL)
    change(columns[name])
    write_columns(rig.folder / "log.parquet", columns)
    severe = int(code in ERRORS)  # what is left out makes nothing wrong
    seen = rig.run("inspect", "log.parquet", *ROBOT)
    assert seen.code == severe
    assert code in seen.out + seen.err
    done = rig.run("friction", "log.parquet", *ROBOT, "--strict", "-o", "f.json")
    assert done.code == severe
    assert f"[{code}]" in (rig.folder / "f.json").read_text()
    assert not severe or f"log.parquet: [{code}] joint_1" in done.err


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda lines: [*lines[:-1], lines[-1][:-7]], "cut short, it is left out"),
        (lambda lines: [*lines[:400], *lines[700:]], "[clock_gap]"),
    ],
    ids=["cut", "gap"],
)
def test_damaged_tables(
    rig: Rig, damage: Callable[[list[bytes]], list[bytes]], message: str
) -> None:
    path = rig.folder / "log.csv"
    csv.write_csv(pq.read_table(TRIAL).slice(0, 40_000), path)
    path.write_bytes(b"".join(damage(path.read_bytes().splitlines(keepends=True))))
    said = " ".join(rig.run("friction", "log.csv", *ROBOT, "-o", "f.json").err.split())
    assert message in said
    assert "log.csv" in said
