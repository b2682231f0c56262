"""ROS bags: whole, damaged, without the library."""

import bz2
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.chunks import allowed
from seqid_cli.logs.mcap.rosbags import _bounded
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.files import expand
from seqid_cli.robot.toml_schema import Channels
from tests.unit.logs import format_writers as formats
from tests.unit.logs.format_writers import (
    T0_NS,
    Data,
    rosbag1,
    rosbag2_sqlite,
    write_bag,
)
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import arm_messages

MOTION = make_motion(grid())
DATA = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)


def storage(folder: Path) -> Path:
    (path,) = expand([str(folder)])
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_joints_and_imus(tmp_path: Path, version: int) -> None:
    channels = {"accelerometers": MOTION.accelerometers, "gyros": MOTION.gyros}
    messages = arm_messages(MOTION.t, JOINTS, MOTION.q, effort=MOTION.tau, **channels)
    messages.append(("/chatter", T0_NS, SimpleNamespace(data="hello")))
    path = write_bag(tmp_path / ("log.bag" if version == 1 else "log"), messages)
    recording = read_recording(path, make_robot(imus=(ARRAY, GYRO)))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.dq is None
    for name in ("array", "hand"):
        np.testing.assert_array_equal(
            recording.accelerometers[name], MOTION.accelerometers[name]
        )
    np.testing.assert_array_equal(recording.gyros["hand"], MOTION.gyros["hand"])
    assert (recording.partial, recording.format) == ("", f"rosbag{version}")
    assert recording.start == pytest.approx(T0_NS * 1e-9, abs=1e-6)


@pytest.mark.parametrize("defined", [True, False])
def test_dynamic_joint_states(tmp_path: Path, defined: bool) -> None:
    """Without a definition in the bag (before 2023) the usual one is taken."""
    current = {"effort": "current", "velocity": "speed"}
    messages = formats.dynamic_states(DATA)
    for _, _, content in messages:
        for one in content.interface_values:
            one.interface_names = [
                current.get(name, name) for name in one.interface_names
            ]
    write_bag(tmp_path / "bag", messages)
    path = storage(tmp_path)
    if not defined:
        executed(path, "UPDATE message_definitions SET encoded_message_definition = ''")
    robot = make_robot(
        constants=0.1, gear_ratio=10.0, channels=Channels(effort="current")
    )
    recording = read_recording(path, robot)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_allclose(recording.tau, MOTION.tau, rtol=1e-15)
    assert read_recording(path, make_robot()).tau is None


def executed(path: Path, text: str) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(text)


def test_compression(tmp_path: Path) -> None:
    messages = formats.reversed_states(DATA)
    bag = write_bag(tmp_path / "one", messages, compression=CompressionMode.MESSAGE)
    np.testing.assert_array_equal(read_recording(bag, make_robot()).q, MOTION.q)
    bag = write_bag(tmp_path / "all", messages, compression=CompressionMode.FILE)
    with pytest.raises(InputError, match="ROS 2 bag without") as caught:
        read_recording(bag, make_robot())
    assert "zstd -d" in caught.value.hint


def outcome(path: Path) -> Recording | InputError:
    try:
        return read_recording(path, make_robot())
    except InputError as error:
        return error


def test_a_bag_is_read_up_to_a_damaged_page_and_told(tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    whole = path.read_bytes()
    refused = 0
    n_read = []
    for page in range(1, len(whole) // 4096):
        data = bytearray(whole)
        data[4096 * page : 4096 * (page + 1)] = b"\xff" * 4096
        path.write_bytes(data)
        found = outcome(path)
        if isinstance(found, InputError):
            refused += 1
            assert found.where == str(path)
            assert ".recover" in found.hint or found.hint.startswith("Record ")
            continue
        n_read.append(len(found.t))
        np.testing.assert_array_equal(found.q, MOTION.q[: len(found.t)])
        assert (found.partial == "") == (len(found.t) == len(MOTION.t))
    assert refused > 3
    assert len(set(n_read)) > 5


@pytest.mark.slow
@pytest.mark.parametrize("pack", [bz2.compress, lz4.frame.compress], ids=["bz2", "lz4"])
def test_a_chunk_that_unpacks_to_gigabytes_is_refused(
    pack: Callable[[bytes], bytes],
) -> None:
    unpack = _bounded(pytest.fail)
    assert unpack(pack(b"sound" * 1000)) == b"sound" * 1000
    bomb = pack(bytes(allowed(0) + (1 << 22) if pack is bz2.compress else 300 << 20))
    with pytest.raises(ValueError, match="unpacks to over"):
        unpack(bomb)


def test_journal_of_a_recorder_that_was_killed_is_told(tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    path.with_name(path.name + "-wal").write_bytes(b"x" * 100)
    partial = read_recording(path, make_robot()).partial
    assert "100 bytes" in partial
    assert "wal_checkpoint" in partial


@pytest.mark.parametrize("change", ["cut", "index", "chunk"])
def test_damaged_ros1_bag(tmp_path: Path, change: str) -> None:
    path = rosbag1(tmp_path / "log", DATA)
    data = bytearray(path.read_bytes())
    middle, index = len(data) // 2, data.index(b"index_pos=") + len(b"index_pos=")
    if change == "cut":
        del data[middle:]
    elif change == "index":
        data[index : index + 8] = bytes(8)
    else:
        data[middle : middle + 200] = b"\xff" * 200
    path.write_bytes(data)
    found = outcome(path)
    if isinstance(found, InputError):
        assert found.where == str(path)
        assert "rosbag reindex" in found.hint
    else:
        assert change == "chunk"
        assert found.partial


def test_a_missing_library_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = rosbag1(tmp_path / "log", DATA)
    needless = [
        rosbag2_sqlite(tmp_path / "sqlite", DATA),
        formats.rosbag2_mcap(tmp_path / "mcap", DATA),
    ]
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InputError, match="not installed") as caught:
        read_recording(path, make_robot())
    assert 'pip install "seqid[bags]"' in caught.value.hint
    for bag in needless:
        np.testing.assert_array_equal(read_recording(bag, make_robot()).q, MOTION.q)
