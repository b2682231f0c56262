"""Results on disk: whole or not at all, never over an input, and refused before any
work.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from seqid_cli.errors import UsageError
from seqid_cli.params import files
from seqid_cli.params.files import (
    check_output,
    leftovers,
    replacing,
    write_text_atomic,
)

PROGRAM = """
import sys
from pathlib import Path
from seqid_cli.params.files import write_text_atomic
for _ in range(30):
    write_text_atomic(Path(sys.argv[1]), sys.argv[2] * 100_000)
"""


def test_two_writers_never_tear_a_file(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text("a" * 100_000)
    writers = [
        subprocess.Popen([sys.executable, "-c", PROGRAM, str(path), name])
        for name in "ab"
    ]
    while any(writer.poll() is None for writer in writers):
        assert path.read_text() in ("a" * 100_000, "b" * 100_000)
    assert [writer.returncode for writer in writers] == [0, 0]
    assert list(tmp_path.iterdir()) == [path]


def test_new_files_have_the_usual_rights_and_links_that_lead_somewhere_stay(
    tmp_path: Path,
) -> None:
    (tmp_path / "real.json").touch()
    for name, target in (("link.json", "real.json"), ("loop.json", "loop.json")):
        (tmp_path / name).symlink_to(tmp_path / target)
    for name in ("out.json", "link.json", "loop.json"):
        check_output(tmp_path / name, [tmp_path / "in.json"])
        write_text_atomic(tmp_path / name, "new")
        assert (tmp_path / name).read_text() == "new"
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "real.json").read_text() == "new"
    (tmp_path / "plain").touch()
    assert (tmp_path / "out.json").stat().st_mode == (tmp_path / "plain").stat().st_mode
    write_text_atomic(Path(os.devnull), "x")
    assert not Path(os.devnull).is_file()  # a device is written, not replaced


def test_what_a_killed_run_left_is_removed_and_what_a_living_one_writes_stays(
    tmp_path: Path,
) -> None:
    """Whatever the numbers of the processes: containers may have the same."""
    target = tmp_path / "a[1].json"
    left = tmp_path / ".a[1].json.0123.tmp"
    left.write_text("half")
    with replacing(target) as written:
        written.write_text("half")
        write_text_atomic(target, "whole")
        assert (left.exists(), written.exists()) == (False, True)
        assert list(leftovers(target)) == [written]
    assert target.read_text() == "half"
    assert list(tmp_path.iterdir()) == [target]


def test_without_locks_leftovers_go_by_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)
    new, old = tmp_path / ".a.json.1.tmp", tmp_path / ".a.json.2.tmp"
    for path in (new, old):
        path.write_text("half")
    two_days_ago = time.time() - 2 * 86400.0
    os.utime(old, (two_days_ago, two_days_ago))
    write_text_atomic(tmp_path / "a.json", "whole")
    assert (new.exists(), old.exists()) == (True, False)


def test_a_new_file_that_is_taken_for_a_leftover_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between making and locking it another run may clean up."""
    own, made = files._locked, []

    def after_a_cleaning(path: Path) -> int | None:
        made.append(path)
        if len(made) < 3:
            path.unlink()
        return own(path)

    monkeypatch.setattr(files, "_locked", after_a_cleaning)
    write_text_atomic(tmp_path / "a.json", "whole")
    assert (tmp_path / "a.json").read_text() == "whole"
    assert len(set(made)) == len(made)
    monkeypatch.setattr(files, "_locked", lambda path: own(path.parent / "gone"))
    with pytest.raises(UsageError, match="cannot be written"):
        write_text_atomic(tmp_path / "a.json", "again")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_an_interrupt_while_a_place_is_tried_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Path.touch

    def interrupted(path: Path, *, exist_ok: bool = True) -> None:
        own(path, exist_ok=exist_ok)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "touch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        check_output(tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


def test_an_input_is_never_overwritten(tmp_path: Path) -> None:
    source = tmp_path / "in.json"
    source.write_text("precious")
    (tmp_path / "same.json").hardlink_to(source)
    for path in (source, tmp_path / "." / "in.json", tmp_path / "same.json"):
        with pytest.raises(UsageError, match="is an input"):
            write_text_atomic(path, "x", inputs=[source])
    assert source.read_text() == "precious"


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("no/out.json", "folder does not exist"),
        (".", "is a folder"),
        ("n" * 256, "cannot be written: File name too long"),
        ("/proc/out.json", "writ"),
        *(
            (stream, "must be a file")
            for stream in ("-", "/dev/stdout", "/proc/self/fd/2")
        ),
    ],
)
def test_what_cannot_be_written_is_said_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=message) as caught:
        check_output(Path(path))
    assert caught.value.hint
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("length", [200, 249, 255])
def test_every_name_that_the_file_system_takes_is_written(
    length: int, tmp_path: Path
) -> None:
    path = tmp_path / ("ö" * 50 + "n" * (length - 100))
    with files._temporary(path) as temporary:
        left = temporary.with_suffix(".999.tmp")
    left.write_text("half")
    write_text_atomic(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_rights(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UsageError, match="not writable"):
        check_output(tmp_path / "out.json")
