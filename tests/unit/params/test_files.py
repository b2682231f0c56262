"""Results on disk: whole or not at all, never over an input, and refused before any
work.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli.errors import UsageError
from seqid_cli.params import files
from seqid_cli.params.files import check_output, write_text_atomic

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
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left, written = (tmp_path / f".a[1].json.{x}.tmp" for x in (gone.pid, os.getppid()))
    for path in (left, written):
        path.write_text("half")
    write_text_atomic(tmp_path / "a[1].json", "whole")
    assert (left.exists(), written.exists()) == (False, True)


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
    left = tmp_path / files._temporary(path).name.replace(
        f".{os.getpid()}.", ".999999999."
    )
    left.write_text("half")
    write_text_atomic(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_rights(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UsageError, match="not writable"):
        check_output(tmp_path / "out.json")
