"""Copies of logs: what killed runs left is removed, a full disk is named."""

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.temporary import temporary_folder


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


def test_no_room_for_a_copy_is_told(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    with (
        pytest.raises(InputError, match="cannot be copied: No space") as caught,
        temporary_folder("a"),
    ):
        pass
    assert caught.value.where == "a"
    assert str(room) in caught.value.hint
