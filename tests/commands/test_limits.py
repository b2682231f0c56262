"""Logs that change or vanish, little memory, few files; commands killed or on a full disk."""

import os
import resource
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from seqid_cli.discover.excerpts import excerpts
from seqid_cli.logs import pieces, read
from tests import ROOT
from tests.commands.conftest import Rig
from tests.commands.torment import COMMANDS, torment
from tests.studies.soak import write_log

SAMPLES = ROOT / "sample_logs" / "one_joint"
ROBOT = ("-r", str(SAMPLES / "robot.toml"))
MODEL = ("-p", str(SAMPLES / "golden.json"))


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def grow(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


@pytest.mark.parametrize(
    ("change", "said"),
    [(cut, "changed while"), (grow, "changed while"), (Path.unlink, "cannot be read")],
)
def test_a_log_that_changes_is_refused(
    change: Callable[[Path], None], said: str, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, own = rig.folder / "log.parquet", read.read_whole
    shutil.copy(SAMPLES / "validation" / "point_to_point.parquet", log)

    def changing(*arguments: object) -> object:
        raw = own(*arguments)  # type: ignore[arg-type]
        change(log)
        return raw

    monkeypatch.setattr(read, "read_whole", changing)
    done = rig.run("predict", "log.parquet", *ROBOT, *MODEL, "-o", "p.json")
    assert done.code == 2
    assert said in done.err
    assert not (rig.folder / "p.json").exists()


def test_too_little_memory_is_no_bug(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError("Unable to allocate 8 GiB")

    monkeypatch.setattr(read, "read_whole", full)
    done = rig.run("predict", str(SAMPLES / "validation"), *ROBOT, *MODEL)
    assert done.code == 2
    assert "there is too little memory (Unable to allocate 8 GiB)" in done.err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
def test_a_gibibyte_and_64_files_are_enough(tmp_path: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))

    command = [sys.executable, "-m", "seqid_cli", "friction", str(SAMPLES / "friction"), *ROBOT]
    done = subprocess.run(
        [*command, "-o", str(tmp_path / "f.json")],
        preexec_fn=limit,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")
@pytest.mark.parametrize("command", ["inspect", "diagnose"])
def test_memory_does_not_grow_with_the_log(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts, taken = pieces.read_parts.__kwdefaults__, excerpts.take_excerpts.__kwdefaults__
    assert parts is not None
    assert taken is not None
    monkeypatch.setitem(parts, "most_values", 300_000)
    monkeypatch.setitem(taken, "most_values", 120_000)
    monkeypatch.setattr(excerpts, "PASSED_OVER", 1000)
    model = () if command == "inspect" else MODEL

    def lines(minutes: float) -> list[str]:
        log, out = tmp_path / f"{minutes}.parquet", tmp_path / "out.json"
        write_log(log, minutes / 60.0)
        return [command, str(log), *ROBOT, *model, "-o", str(out)]

    def peak(line: list[str]) -> int:
        tracemalloc.start()
        assert main(line) == 0
        held = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return held

    short, long = lines(1.0), lines(2.0)
    assert main(short) == 0  # what is made once is there
    assert peak(long) < 1.2 * peak(short)


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("friction", 1),
        ("trend", 2),
        pytest.param("predict, MCAP", 2, marks=pytest.mark.slow),
        pytest.param("predict", 2, marks=pytest.mark.slow),
        pytest.param("report", 1, marks=pytest.mark.slow),
    ],
)
def test_old_files_stay_whole(name: str, files: int, tmp_path: Path) -> None:
    forks = torment(COMMANDS[name], tmp_path, kills=12, points=6)
    assert not forks.wrong
    assert len(forks.sizes) == files
    assert forks.killed >= 10
    assert forks.inside
    assert forks.full >= 6  # one a file at least
