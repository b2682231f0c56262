"""Lists in Parquet, as LeRobot writes them, and episodes that are never joined."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.toml.schema import Channels
from tests.unit.logs.format_writers import Data, lerobot_table
from tests.unit.logs.samples import JOINTS, curve, grid, make_motion, make_robot

T = grid(120, 30.0)
MOTION = make_motion(T)
LISTS = pa.list_(pa.float32())


def read(path: Path, table: pa.Table | dict[str, object], **options: object) -> Recording:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(table), path)
    return read_recording(path, make_robot(**options))  # type: ignore[arg-type]


def episode(shift: float, count: int = 120) -> Data:
    q = curve(T[:count], 3, shift)
    return Data(T[:count], JOINTS, q, q, q, 10.0 * q)


def test_episodes_become_stretches_with_gaps(tmp_path: Path) -> None:
    episodes = [episode(0.0), episode(5.0, 60), episode(9.0, 90)]
    recording = read(tmp_path / "file-000.parquet", lerobot_table(episodes))
    assert any("3 episodes" in warning for warning in recording.health.warnings)
    starts = np.flatnonzero(np.diff(recording.valid.astype(int), prepend=0) > 0)
    ends = np.flatnonzero(np.diff(recording.valid.astype(int), append=0) < 0) + 1
    assert (ends - starts).tolist() == [120, 60, 90]
    for start, end, data in zip(starts, ends, episodes, strict=True):
        np.testing.assert_allclose(recording.q[start:end], data.q, atol=2e-5)
    assert [end - start > 1.0 for start, end in recording.health.gaps] == [True, True]


def test_rows_without_an_episode_are_left_out(tmp_path: Path) -> None:
    table = lerobot_table([episode(0.0)])
    numbers = pa.array([0] * 100 + [None] * 20, pa.int64())
    place = table.schema.get_field_index("episode_index")
    table = table.set_column(place, "episode_index", numbers)
    recording = read(tmp_path / "a.parquet", table)
    assert len(recording.t) == 100
    assert any("20 rows without episode_index" in w for w in recording.health.warnings)


def read_set(folder: Path, names: object, length: int) -> Recording:
    """Read a data set that names the motors; the last of `length` values is a gripper."""
    info = folder / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
    states = pa.array(list(curve(T, length).astype(np.float32)), LISTS)
    table = {"observation.state": states, "timestamp": T.astype(np.float32)}
    return read(folder / "data" / "chunk-000" / "episode_000000.parquet", table)


ORDER = [1, 3, 0]  # of the joints among the motors
MOTORS = ["wrist", "shoulder", "gripper", "elbow"]


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        ([f"{name}.pos" for name in MOTORS], ORDER),
        ({"motors": MOTORS}, ORDER),
        *((names, [0, 1, 2]) for names in (None, 7, ["a", "b"], [["a"]], {"x": [], "y": []})),
    ],
)
def test_joints_are_matched_by_the_names_of_the_data_set(
    tmp_path: Path, names: object, columns: list[int]
) -> None:
    recording = read_set(tmp_path, names, 4)
    np.testing.assert_allclose(recording.q, curve(T, 4)[:, columns], atol=1e-6)
    told = any("in the order of the robot file" in warning for warning in recording.health.warnings)
    assert told == (columns != ORDER)


def test_lists_of_another_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column 'observation\.state\[2\]'"):
        read_set(tmp_path, None, 2)
    rows = [row.tolist() for row in MOTION.q]
    rows[17] = rows[17][:2]
    table = {"t": T, "observation.state": pa.array(rows, LISTS)}
    with pytest.raises(InputError, match=r"row 18: 'observation\.state' holds 2 values") as caught:
        read(tmp_path / "a.parquet", table)
    assert caught.value.hint


@pytest.mark.parametrize("kind", [LISTS, pa.list_(pa.float64(), 3), pa.large_list(pa.float64())])
def test_missing_lists_and_values(tmp_path: Path, kind: pa.DataType) -> None:
    rows: list[object] = [row.tolist() for row in MOTION.q]
    rows[0] = None
    rows[40] = [None, *MOTION.q[40, 1:].tolist()]
    rows[60] = [float("nan")] * 3
    recording = read(tmp_path / "a.parquet", {"t": T, "q": pa.array(rows, kind)})
    assert len(recording.t) == 119
    np.testing.assert_allclose(recording.q, MOTION.q[1:], atol=2e-5)


def test_joint_state_messages_in_a_table(tmp_path: Path) -> None:
    names = ["wrist", "elbow", "shoulder"]
    rows = {
        "timestamp": T,
        "name": [names] * 120,
        "position": list(MOTION.q[:, ::-1]),
        "velocity": [[]] * 120,
        "effort": list(MOTION.tau[:, ::-1]),
    }
    recording = read(tmp_path / "a.parquet", rows)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    assert recording.dq is None
    rows["name"] = [names] * 60 + [names[::-1]] * 60
    with pytest.raises(InputError, match="change from row to row"):
        read(tmp_path / "a.parquet", rows)


@pytest.mark.parametrize("form", ["{name}/{kind}", "{kind}.{name}"])
@pytest.mark.parametrize("current", [False, True])
def test_effort_is_what_the_robot_file_says(tmp_path: Path, form: str, current: bool) -> None:
    columns = {"time": T, form.format(name="gripper", kind="position"): T}
    for name, q, tau in zip(JOINTS, MOTION.q.T, MOTION.tau.T, strict=True):
        columns |= {form.format(name=name, kind="position"): q}
        columns |= {form.format(name=name, kind="effort"): tau}
    channels = Channels(effort="current") if current else Channels()
    robot = {"constants": 0.1, "gear_ratio": 100.0, "channels": channels}
    recording = read(tmp_path / "a.parquet", columns, **robot)
    np.testing.assert_allclose(recording.tau, MOTION.tau * (10.0 if current else 1.0))
