"""Logs in every format: the same recording, and what they hold without a robot file."""

from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.inspect.guess import guess, stand_in
from seqid_cli.logs.contents import LogContents, contents_of
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.logs.tables.naming_schemes import SCHEMES, find_scheme
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.unit.logs.format_writers import EXACT, FLOAT32, Data
from tests.unit.logs.samples import JOINTS, grid, make_motion, write_motion

ONE, SIX = (ROOT / "sample_logs" / name for name in ("one_joint", "six_joint"))
FLOAT32_STEP = 2.0**-23


@cache
def robot(folder: Path) -> Robot:
    return load_robot(folder / "robot.toml")


@cache
def sample(folder: Path, name: str, every: int) -> Data:
    table = pq.read_table(folder / f"{name}.parquet")[::every]
    joints = robot(folder).joint_names

    def columns(quantity: str) -> Array:
        return np.column_stack(
            [table.column(f"{j}.{quantity}").to_numpy() for j in joints]
        )

    t = np.rint(table.column("t").to_numpy() * 1e3) / 1e3
    q, current = columns("position"), columns("current")
    constants = np.array([j.torque_per_ampere or 0.0 for j in robot(folder).joints])
    return Data(t, joints, q, np.gradient(q, t, axis=0), current, current * constants)


def check_arrays(recording: Recording, data: Data, label: str) -> None:
    coarse = (FLOAT32_STEP, FLOAT32_STEP * float(data.t[-1]))
    step, late = coarse if label in FLOAT32 else (2.0**-50, 2e-9)
    np.testing.assert_allclose(recording.t, data.t - data.t[0], rtol=0, atol=late)
    np.testing.assert_allclose(recording.q, data.q, rtol=step, atol=0)
    scale = np.abs(data.torque).max(axis=0)
    assert (np.abs(recording.tau - data.torque) <= 2 * step * scale).all()
    if recording.dq is not None:
        np.testing.assert_allclose(recording.dq, data.dq, rtol=step, atol=0)
    assert (recording.dq is None) == (label in FLOAT32 or "json" in label)
    assert recording.valid.all()
    assert (recording.partial, recording.health.gaps) == ("", ())


@pytest.mark.slow
@pytest.mark.parametrize("label", [*EXACT, *FLOAT32])
@pytest.mark.parametrize(
    ("folder", "name", "every"),
    [(ONE, "gravity/joint_1", 16), (SIX, "inertia/elbow__wrist_1", 4)],
)
def test_same_recording(
    tmp_path: Path, label: str, folder: Path, name: str, every: int
) -> None:
    data = sample(folder, name, every)
    path = ({**EXACT, **FLOAT32})[label](tmp_path / "log", data)
    (found,) = expand([str(tmp_path)])
    if path.is_dir():
        check_arrays(read_recording(path, robot(folder)), data, label)
    renamed = found.rename(tmp_path / "log.dat")  # the suffix does not matter
    recording = read_recording(renamed, robot(folder))
    check_arrays(recording, data, label)
    kinds = {
        "parquet": "parquet",
        "lerobot": "parquet",
        "csv": "csv",
        "rosbag1": "rosbag1",
    }
    kind = (
        "rosbag2" if label == "rosbag2 sqlite" else kinds.get(label.split()[0], "mcap")
    )
    assert check_log(renamed) == recording.format == kind


MOTION = make_motion(grid(100))


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_topics_of_mcap_are_its_channels(tmp_path: Path, encoding: str) -> None:
    found = contents_of(write_motion(tmp_path / "log.mcap", MOTION, encoding=encoding))
    assert found.joints == JOINTS
    assert {"/joint_states", "/array/accel_2"} <= set(found.channels)


NAMED = ("csv", "rosbag1", "mcap cdr", "mcap json")


@pytest.mark.parametrize("label", [*NAMED, "csv rtde", "csv libfranka", "lerobot"])
def test_joints_are_guessed(tmp_path: Path, label: str) -> None:
    data = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
    path = ({**EXACT, **FLOAT32})[label](tmp_path / "log", data)
    found = guess(contents_of(path))
    named = label in NAMED
    assert set(found.joints) == set(
        JOINTS if named else ("joint_1", "joint_2", "joint_3")
    )
    recording = read_recording(path, stand_in(found, source=path))
    order = [found.joints.index(name) for name in JOINTS] if named else [0, 1, 2]
    np.testing.assert_allclose(recording.q[:, order], MOTION.q, rtol=2.0**-23)


@pytest.mark.parametrize(
    ("columns", "joints"),
    [
        ("elbow_q wrist_q", ("elbow", "wrist")),
        ("freq_q", ()),  # few letters stand for a quantity of several joints
        ("angle", ("joint_1",)),
        ("elbow.q", ("elbow",)),
        (
            "/joint_states/elbow/position /joint_states/wrist/position",
            ("elbow", "wrist"),
        ),
        ("left_joint_1.pos left_joint_2.pos", ("left_joint_1", "left_joint_2")),
        ("motor_a/q motor_b/q", ("motor_a", "motor_b")),
        ("q_1 position.x position.y target.pos", ("joint_1",)),
        ("level", ()),
    ],
)
def test_joints_of_a_table(
    tmp_path: Path, columns: str, joints: tuple[str, ...]
) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(dict.fromkeys(["time", *columns.split()], MOTION.t)), path)
    assert guess(contents_of(path)).joints == joints


NAMED_PATTERNS = sorted(
    {
        name
        for scheme in SCHEMES
        for name in scheme.patterns["position"]
        if "{name}" in name
    }
)


@pytest.mark.parametrize("pattern", NAMED_PATTERNS)
def test_joints_that_are_read_undeclared_are_guessed(pattern: str) -> None:
    """What `inspect -r` reads by its names alone, `init` does not refuse."""
    joints = ("left_joint_1", "servo_pan")
    columns = ("time", *(pattern.replace("{name}", name) for name in joints))
    guessed = guess(
        LogContents(format="csv", channels=columns, joints=(), columns=columns)
    )
    assert guessed.joints == joints
    match = find_scheme(guessed.joints, columns)
    assert match is not None
    assert match.columns["position"] == [*columns[1:]]
