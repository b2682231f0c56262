"""Lists in Parquet, as LeRobot writes them, and episodes that are never joined."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.toml.schema import Channels
from tests.unit.logs.format_writers import Data, lerobot_table
from tests.unit.logs.samples import JOINTS, curve, grid, make_motion, make_robot

MOTION = make_motion(grid(120, 30.0))
LISTS = pa.list_(pa.float32())


def episode(shift: float, count: int = 120) -> Data:
    t = grid(count, 30.0)
    q = curve(t, 3, shift)
    return Data(t, JOINTS, q, q, q, 10.0 * q)


def write(path: Path, table: pa.Table) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)
    return path


def test_episodes_become_stretches_with_gaps(tmp_path: Path) -> None:
    episodes = [episode(0.0), episode(5.0, 60), episode(9.0, 90)]
    recording = read_recording(
        write(tmp_path / "file-000.parquet", lerobot_table(episodes)), make_robot()
    )
    assert len(recording.health.gaps) == 2
    assert any("3 episodes" in warning for warning in recording.health.warnings)
    ends = np.flatnonzero(np.diff(recording.valid.astype(int))) + 1
    stretches = [s for s in np.split(np.arange(len(recording.t)), ends) if recording.valid[s[0]]]
    assert [len(s) for s in stretches] == [120, 60, 90]
    for stretch, data in zip(stretches, episodes, strict=True):
        np.testing.assert_allclose(recording.q[stretch], data.q, atol=2e-5)
    for start, end in recording.health.gaps:
        assert end - start > 1.0


def test_rows_without_an_episode_are_left_out(tmp_path: Path) -> None:
    table = lerobot_table([episode(0.0)])
    numbers = [0] * 100 + [None] * 20
    place = table.schema.get_field_index("episode_index")
    table = table.set_column(place, "episode_index", pa.array(numbers, pa.int64()))
    recording = read_recording(write(tmp_path / "a.parquet", table), make_robot())
    assert len(recording.t) == 100
    assert any("20 rows without episode_index" in w for w in recording.health.warnings)


def data_set(folder: Path, names: object, length: int) -> Path:
    """A data set that names the motors; the last of `length` values is a gripper."""
    q = curve(grid(100, 30.0), length)
    table = pa.table(
        {
            "observation.state": pa.array(list(q.astype(np.float32)), LISTS),
            "timestamp": pa.array(grid(100, 30.0).astype(np.float32)),
            "episode_index": np.zeros(100, np.int64),
        }
    )
    info = folder / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
    return write(folder / "data" / "chunk-000" / "episode_000000.parquet", table)


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
    recording = read_recording(data_set(tmp_path, names, 4), make_robot())
    np.testing.assert_allclose(recording.q, curve(grid(100, 30.0), 4)[:, columns], atol=1e-6)
    told = any("in the order of the robot file" in warning for warning in recording.health.warnings)
    assert told == (columns != ORDER)


def test_lists_of_another_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column 'observation\.state\[2\]'"):
        read_recording(data_set(tmp_path, None, 2), make_robot())
    rows = [row.tolist() for row in MOTION.q]
    rows[17] = rows[17][:2]
    table = pa.table({"t": MOTION.t, "observation.state": pa.array(rows, LISTS)})
    with pytest.raises(InputError, match=r"row 18: 'observation\.state' holds 2 values") as caught:
        read_recording(write(tmp_path / "a.parquet", table), make_robot())
    assert caught.value.hint


@pytest.mark.parametrize("kind", [LISTS, pa.list_(pa.float64(), 3), pa.large_list(pa.float64())])
def test_missing_lists_and_values(tmp_path: Path, kind: pa.DataType) -> None:
    rows: list[object] = [row.tolist() for row in MOTION.q]
    rows[0] = None
    rows[40] = [None, *MOTION.q[40, 1:].tolist()]
    rows[60] = [float("nan")] * 3
    table = pa.table({"t": MOTION.t, "q": pa.array(rows, kind)})
    recording = read_recording(write(tmp_path / "a.parquet", table), make_robot())
    assert len(recording.t) == 119
    np.testing.assert_allclose(recording.q, MOTION.q[1:], atol=2e-5)


def test_joint_state_messages_in_a_table(tmp_path: Path) -> None:
    names = ["wrist", "elbow", "shoulder"]
    rows = {
        "timestamp": MOTION.t,
        "name": [names] * 120,
        "position": list(MOTION.q[:, ::-1]),
        "velocity": [[]] * 120,
        "effort": list(MOTION.tau[:, ::-1]),
    }
    path = write(tmp_path / "a.parquet", pa.table(rows))
    recording = read_recording(path, make_robot())
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.tau is not None
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    assert recording.dq is None
    rows["name"] = [names] * 60 + [names[::-1]] * 60
    with pytest.raises(InputError, match="change from row to row"):
        read_recording(write(path, pa.table(rows)), make_robot())


@pytest.mark.parametrize("form", ["{name}/{kind}", "{kind}.{name}"])
@pytest.mark.parametrize("current", [False, True])
def test_effort_is_what_the_robot_file_says(tmp_path: Path, form: str, current: bool) -> None:
    columns = {"time": MOTION.t, form.format(name="gripper", kind="position"): MOTION.t}
    for i, name in enumerate(JOINTS):
        columns[form.format(name=name, kind="position")] = MOTION.q[:, i]
        columns[form.format(name=name, kind="effort")] = MOTION.tau[:, i]
    channels = Channels(effort="current") if current else Channels()
    robot = make_robot(constants=0.1, gear_ratio=100.0, channels=channels)
    recording = read_recording(write(tmp_path / "a.parquet", pa.table(columns)), robot)
    np.testing.assert_allclose(recording.tau, MOTION.tau * (10.0 if current else 1.0))
