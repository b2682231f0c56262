"""What a log holds, without a robot file."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.inspect.guess import guess, stand_in
from seqid_cli.logs.contents import survey
from seqid_cli.logs.read import read_recording
from tests.unit.logs.format_writers import EXACT, FLOAT32, Data
from tests.unit.logs.samples import JOINTS, grid, make_motion, write_motion

MOTION = make_motion(grid(100))


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_mcap(tmp_path: Path, encoding: str) -> None:
    found = survey(write_motion(tmp_path / "log.mcap", MOTION, encoding=encoding))
    assert found.joints == JOINTS
    counts = {channel.name: channel.samples for channel in found.channels}
    assert counts["/joint_states"] == counts["/array/accel_2"] == 100


@pytest.mark.parametrize("label", ["csv", "csv rtde", "csv libfranka", "rosbag1", "lerobot"])
def test_other_formats(tmp_path: Path, label: str) -> None:
    data = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
    path = ({**EXACT, **FLOAT32})[label](tmp_path / "log", data)
    surveyed = survey(path)
    found = guess(surveyed)
    named = label in ("csv", "rosbag1")
    assert set(found.joints) == set(JOINTS if named else ("joint_1", "joint_2", "joint_3"))
    assert {channel.samples for channel in surveyed.channels} == {100}
    recording = read_recording(path, stand_in(found, source=path))
    order = [found.joints.index(name) for name in JOINTS] if named else [0, 1, 2]
    np.testing.assert_allclose(recording.q[:, order], MOTION.q, rtol=2.0**-23)


@pytest.mark.parametrize(
    ("columns", "joints"),
    [
        ("elbow_q wrist_q", ("elbow", "wrist")),
        ("freq_q", ()),  # few letters stand for a quantity of several joints
        ("angle", ("joint_1",)),
        ("level", ()),
    ],
)
def test_joints_of_a_table(tmp_path: Path, columns: str, joints: tuple[str, ...]) -> None:
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(dict.fromkeys(["time", *columns.split()], MOTION.t)), path)
    assert guess(survey(path)).joints == joints
