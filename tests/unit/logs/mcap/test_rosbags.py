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
from seqid_cli.robot.toml.schema import Channels
from tests.unit.logs.format_writers import (
    T0_NS,
    Data,
    reversed_states,
    rosbag1,
    rosbag2_mcap,
    rosbag2_sqlite,
    write_bag,
)
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import arm_messages, header

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
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    assert recording.dq is None
    for name in ("array", "hand"):
        np.testing.assert_array_equal(recording.accelerometers[name], MOTION.accelerometers[name])
    np.testing.assert_array_equal(recording.gyros["hand"], MOTION.gyros["hand"])
    assert (recording.partial, recording.format) == ("", f"rosbag{version}")
    assert recording.start == pytest.approx(T0_NS * 1e-9, abs=1e-6)


@pytest.mark.parametrize("defined", [True, False])
def test_dynamic_joint_states(tmp_path: Path, defined: bool) -> None:
    """Without a definition in the bag (before 2023) the usual one is taken."""
    messages = []
    for i, at in enumerate(DATA.stamps_ns):
        values = [
            SimpleNamespace(interface_names=["position", "current"], values=pair)
            for pair in np.stack([MOTION.q[i], MOTION.tau[i]], axis=1).tolist()
        ]
        content = SimpleNamespace(
            header=header(at), joint_names=list(JOINTS), interface_values=values
        )
        messages.append(("/dynamic_joint_states", at, content))
    write_bag(tmp_path / "bag", messages)
    path = storage(tmp_path)
    if not defined:
        executed(path, "UPDATE message_definitions SET encoded_message_definition = ''")
    robot = make_robot(constants=0.1, gear_ratio=10.0, channels=Channels(effort="current"))
    recording = read_recording(path, robot)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_allclose(recording.tau, MOTION.tau, rtol=1e-15)
    assert read_recording(path, make_robot()).tau is None


def test_values_of_other_types_than_declared_are_refused(tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    executed(path, "UPDATE topics SET type = x'00ff'")
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(path, make_robot())


def executed(path: Path, text: str) -> None:
    """Change a database."""
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(text)


def test_compression(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "one", reversed_states(DATA), compression=CompressionMode.MESSAGE)
    np.testing.assert_array_equal(read_recording(bag, make_robot()).q, MOTION.q)
    bag = write_bag(tmp_path / "all", reversed_states(DATA), compression=CompressionMode.FILE)
    with pytest.raises(InputError, match="ROS 2 bag without") as caught:
        read_recording(bag, make_robot())
    assert "zstd -d" in caught.value.hint


def outcome(path: Path) -> Recording | InputError:
    try:
        return read_recording(path, make_robot())
    except InputError as error:
        return error


def test_damaged_page_is_refused_with_a_remedy_unless_it_is_not_needed(tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    whole = path.read_bytes()
    refused = 0
    for page in range(1, len(whole) // 4096):
        data = bytearray(whole)
        data[4096 * page : 4096 * (page + 1)] = b"\xff" * 4096
        path.write_bytes(data)
        found = outcome(path)
        if isinstance(found, InputError):
            refused += 1
            assert ".recover" in found.hint or found.hint.startswith("Record ")
            assert found.where == str(path)
        elif not found.partial:
            np.testing.assert_array_equal(found.q, MOTION.q)
    assert refused > 10


def test_cut_sqlite_file(tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(InputError, match="cannot be read") as caught:
        read_recording(path, make_robot())
    assert "recover" in caught.value.hint


def test_sqlite_file_that_is_no_bag(tmp_path: Path) -> None:
    path = tmp_path / "places.db3"
    executed(path, "CREATE TABLE places (x)")
    with pytest.raises(InputError, match="missing tables"):
        read_recording(path, make_robot())


@pytest.mark.parametrize(
    "text",
    [
        "CREATE VIEW more AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
        "SELECT x FROM c",
        "CREATE TABLE more(a INTEGER, b BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        "CREATE TRIGGER more AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    ],
    ids=["view", "column", "trigger"],
)
def test_a_database_that_computes_is_refused(text: str, tmp_path: Path) -> None:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    assert isinstance(outcome(path), Recording)
    executed(path, text)
    found = outcome(path)
    assert isinstance(found, InputError)
    assert "computes values" in found.message


@pytest.mark.parametrize("pack", [bz2.compress, lz4.frame.compress], ids=["bz2", "lz4"])
def test_a_chunk_that_unpacks_to_gigabytes_is_refused(pack: Callable[[bytes], bytes]) -> None:
    def usual(_: bytes) -> bytes:
        raise AssertionError

    unpack = _bounded(usual)
    assert unpack(pack(b"sound" * 1000)) == b"sound" * 1000
    bomb = pack(bytes(allowed(0) + (1 << 22))) if pack is bz2.compress else pack(bytes(300 << 20))
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
    if change == "cut":
        data = data[: len(data) // 2]
    elif change == "index":
        at = data.index(b"index_pos=") + len(b"index_pos=")
        data[at : at + 8] = bytes(8)
    else:
        at = len(data) // 2
        data[at : at + 200] = b"\xff" * 200
    path.write_bytes(data)
    found = outcome(path)
    if isinstance(found, InputError):
        assert found.where == str(path)
        assert "rosbag reindex" in found.hint
    else:
        assert change == "chunk"
        assert found.partial


@pytest.mark.parametrize("write", [rosbag1, rosbag2_sqlite])
def test_without_the_library_the_way_to_install_it_is_told(
    tmp_path: Path, write: Callable[[Path, Data], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "log", DATA)
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InputError, match="not installed") as caught:
        read_recording(path, make_robot())
    assert 'pip install "seqid[bags]"' in caught.value.hint


def test_bag_folder_with_mcap_inside_needs_no_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rosbag2_mcap(tmp_path / "log", DATA)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    np.testing.assert_array_equal(read_recording(tmp_path / "log", make_robot()).q, MOTION.q)
