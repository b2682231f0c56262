"""Copies of logs: what killed runs left is removed, a full disk is named."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.rosbags import as_mcap
from seqid_cli.logs.storage.temporary import temporary_folder
from tests.unit.logs.format_writers import Data, rosbag2_sqlite
from tests.unit.logs.samples import JOINTS, grid, make_motion


@pytest.fixture(autouse=True)
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_folders_of_killed_runs_are_removed(room: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left, running = room / f"seqid-{gone.pid}-a", room / f"seqid-{os.getppid()}-b"
    for folder in (left, running):
        folder.mkdir()
        (folder / "bag.mcap").write_bytes(b"half")
    with temporary_folder("log") as folder:
        assert folder.parent == room
        assert not left.exists()
        assert running.exists()
    assert not folder.exists()


def test_no_room_for_a_copy_is_not_a_damaged_bag(
    room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = make_motion(grid(60))
    data = Data(motion.t, JOINTS, motion.q, motion.dq, motion.tau, motion.tau)
    bag = rosbag2_sqlite(room / "bag", data) / "bag.db3"

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("seqid_cli.logs.mcap.rosbags.Writer.add_message", full)
    with pytest.raises(InputError, match="cannot be copied: No space left") as caught, as_mcap(bag):
        pass
    assert caught.value.where == str(bag)
    assert str(room) in caught.value.hint
