"""A library that ends the process: one message for the file that it read."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import ROOT
from tests.commands.conftest import ONE_JOINT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux watches")

ROBOT = ("-r", str(ONE_JOINT / "robot.toml"))
# No file is known by which Arrow dies today: this one stands for the next.
PROGRAM = """
import os, signal, sys, time
import pyarrow.parquet as pq
import seqid_cli.commands.completion as completion

opened = pq.ParquetFile.__init__
def deadly(self, source, *more, **options):
    if "deadly" in str(source):
        os.kill(os.getpid(), signal.{signal})
    opened(self, source, *more, **options)
pq.ParquetFile.__init__ = deadly

words = completion.all_words
def stopped():
    {stop}
    return words()
completion.all_words = stopped

{before}
from seqid_cli.__main__ import main
sys.exit(main())
"""


def started(
    folder: Path,
    *words: str,
    ends_by: str = "SIGABRT",
    stop: str = "pass",
    before: str = "",
) -> subprocess.Popen[str]:
    program = PROGRAM.format(signal=ends_by, stop=stop, before=before)
    (folder / "program.py").write_text(program)
    return subprocess.Popen(
        [sys.executable, "-m", "program", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Not those of a test that runs in the background.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        start_new_session=True,
    )


def ran(folder: Path, *words: str, **more: str) -> tuple[int, str, str]:
    process = started(folder, *words, **more)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a log by which a library dies, between two sound ones."""
    logs = tmp_path / "logs"
    logs.mkdir()
    for source, name in (
        ("friction/joint_1", "a"),
        ("friction/joint_1", "deadly"),
        ("gravity/joint_1", "z"),
    ):
        shutil.copy(ONE_JOINT / f"{source}.parquet", logs / f"{name}.parquet")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("ends_by", ["SIGABRT", "SIGSEGV"])
def test_a_deadly_log_in_a_folder_is_one_message(folder: Path, ends_by: str) -> None:
    code, out, err = ran(folder, "inspect", "logs", *ROBOT, ends_by=ends_by)
    assert code == 2, err
    assert err.count("dies of it") == 1
    assert f"logs/deadly.parquet: the library that reads it dies of it ({ends_by})" in (
        err
    )
    assert "logs/a.parquet" in out
    assert "logs/z.parquet" in out
    assert "Traceback" not in err


@pytest.mark.slow
def test_stages_go_on_without_a_deadly_log_where_they_may(folder: Path) -> None:
    logs = [f"logs/{name}.parquet" for name in ("a", "deadly")]
    line = ("friction", *logs, *ROBOT, "-o", "f.json")
    code, _, err = ran(folder, *line)
    assert code == 2
    assert "logs/deadly.parquet: the library that reads it dies of it" in err
    assert not (folder / "f.json").exists()
    code, _, err = ran(folder, *line, "--skip-failed")
    assert code == 3, err
    assert "left out: logs/deadly.parquet: the library that reads it dies" in err
    assert (folder / "f.json").stat().st_size > 1000


def test_a_death_of_no_file_is_a_bug(tmp_path: Path) -> None:
    code, _, err = ran(tmp_path, "completion", "bash", stop="os.abort()")
    assert code == 70
    assert err == "seqid: a library has ended the process (SIGABRT); this is a bug\n"


def test_a_process_that_is_killed_says_why(tmp_path: Path) -> None:
    stop = "os.kill(os.getpid(), signal.SIGKILL)"
    code, _, err = ran(tmp_path, "completion", "bash", stop=stop)
    assert code == 2
    assert "killed, most likely because memory ran out" in err


def test_where_no_process_can_be_had_it_works_unwatched(tmp_path: Path) -> None:
    refused = """
def refused():
    raise BlockingIOError("no more processes")
os.fork = refused
"""
    code, out, err = ran(tmp_path, "completion", "bash", before=refused)
    assert (code, err) == (0, "")
    assert out


SLEEPS = "print(os.getpid(), flush=True); time.sleep(60)"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("to", ["the watcher", "both"])
def test_a_signal_ends_both(name: str, to: str, tmp_path: Path) -> None:
    process = started(tmp_path, "completion", "bash", stop=SLEEPS)
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    assert worker != process.pid
    number = getattr(signal, name)
    if to == "both":
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "seqid completion: interrupted\n"


CLEANS_UP = """try:
        print(os.getpid(), flush=True)
        time.sleep(60)
    finally:
        print("begun", flush=True)
        time.sleep(0.3)
        print("ended", flush=True)
"""


def test_a_signal_that_comes_twice_is_one(tmp_path: Path) -> None:
    slow_machine = "import seqid_cli.commands.signals as s; s.SAME_S = 60.0"
    process = started(
        tmp_path, "completion", "bash", stop=CLEANS_UP, before=slow_machine
    )
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    os.kill(worker, signal.SIGTERM)
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert out == "ended\n"
    assert err == "seqid completion: interrupted\n"
    assert process.returncode == 130


def test_no_worker_outlives_its_watcher(tmp_path: Path) -> None:
    process = started(tmp_path, "completion", "bash", stop=SLEEPS)
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    process.kill()
    process.communicate()
    while Path(f"/proc/{worker}").exists():
        time.sleep(0.01)
    assert process.returncode == -signal.SIGKILL
