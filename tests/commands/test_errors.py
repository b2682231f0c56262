"""Exit codes and messages of whatever can go wrong."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from seqid_cli.errors import ConfigError, QualityError, SeqidError
from tests.commands.conftest import Reader, Rig
from tests.commands.transcripts import check_transcript
from tests.unit.params.documents import friction_file, friction_stage, gravity_file

Replace = Callable[[str, str, object], list[object]]
FRICTION = ["friction", "a.parquet", "-r", "robot.toml", "-o", "out.json"]


def test_what_cannot_run(rig: Rig) -> None:
    """Every line has an error, a hint and the exit code 2; with --json a document says the same."""
    rig.params("f.json", friction_file())
    rig.params("g.json", gravity_file())
    other, swapped = friction_file(), friction_file()
    other.robot.name = "leg"
    rig.params("other.json", other)
    swapped.robot.joints = swapped.robot.joints[::-1]
    rig.params("swapped.json", swapped)
    check_transcript(rig, "errors")
    assert "No such option: --cutof" in rig.run("friction", "a", "-r", "r", "--cutof", "3").err
    assert not (rig.folder / "out.json").exists()
    done = rig.run("friction", "no", "-r", "robot.toml", "--json")
    told = {"code": 2, "message": "does not exist", "where": "no"}
    assert json.loads(done.out)["error"].items() >= told.items()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (QualityError("joint elbow never moves alone", hint="Record it."), 1),
        (ConfigError("no", hint="x"), 2),
    ],
)
def test_a_stage_that_gives_up_writes_nothing(
    rig: Rig, reader: Reader, identified: Replace, error: SeqidError, code: int
) -> None:
    (rig.folder / "out.json").write_text("old")
    identified("friction_surface.stage", "identify_friction", error)
    done = rig.run(*FRICTION, "--json")
    assert done.code == code
    assert json.loads(done.out) == {
        "error": {"code": code, "message": error.message, "hint": error.hint, "where": ""}
    }
    assert done.err == f"seqid friction: error: {error}\n  hint: {error.hint}\n"
    assert (rig.folder / "out.json").read_text() == "old"


def test_a_bug_says_so_and_shows_its_traceback_only_on_demand(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    identified("friction_surface.stage", "identify_friction", ZeroDivisionError("ouch"))
    done = rig.run(*FRICTION)
    assert done.code == 70
    assert "this is a bug in seqid: ZeroDivisionError: ouch" in done.err
    assert "Traceback" not in done.err
    assert "Traceback" in rig.run(*FRICTION, "--debug").err
    assert json.loads(rig.run(*FRICTION, "--json").out)["error"]["code"] == 70


def test_a_number_that_is_not_finite_is_a_bug_and_not_a_result(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    stage = friction_stage()
    stage.joints["elbow"].rmse = float("inf")
    identified("friction_surface.stage", "identify_friction", stage)
    done = rig.run(*FRICTION)
    assert done.code == 70
    assert "$.stages.friction.joints.elbow.rmse is inf" in done.err
    assert not (rig.folder / "out.json").exists()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_during_an_import_exits_with_130(name: str, tmp_path: Path) -> None:
    """Imports run texts by `exec`, to make dataclasses; Python remembers an interrupt in those."""
    done = _ran_with_a_signal(tmp_path, name)
    assert done.returncode == 130
    assert done.stderr == b"seqid completion: interrupted\n"


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no interval timer")
def test_a_signal_during_a_finalizer_is_not_lost(tmp_path: Path) -> None:
    """No exception gets out of a finalizer: Python reports and forgets it."""
    ending = "weakref.finalize(completion, signal.raise_signal, signal.SIGTERM)()"
    during = f"import time, weakref; {ending}; time.sleep(20)"
    done = _ran_with_a_signal(tmp_path, "SIGTERM", during=during)
    assert done.returncode == 130
    assert done.stderr == b"seqid completion: interrupted\n"


def test_a_signal_that_the_caller_ignores_stays_ignored(tmp_path: Path) -> None:
    done = _ran_with_a_signal(tmp_path, "SIGHUP", "signal.signal(signal.SIGHUP, signal.SIG_IGN)")
    assert (done.returncode, done.stderr) == (0, b"")


def _ran_with_a_signal(
    folder: Path, name: str, before: str = "", during: str = ""
) -> subprocess.CompletedProcess[bytes]:
    (folder / "program.py").write_text(f"""
import signal, sys
import seqid_cli.commands.completion as completion
signal.signal(signal.{name}, signal.SIG_DFL)  # tests that run in the background ignore some
{before}
words = completion.all_words()
def interrupted():
    {during or f'exec("import signal; signal.raise_signal(signal.{name})")'}
    return words
completion.all_words = interrupted
sys.argv = ["seqid", "completion", "bash"]
from seqid_cli.__main__ import main
sys.exit(main())
""")
    command = [sys.executable, "-m", "program"]  # run as a script, Python forgets the interrupt
    return subprocess.run(command, cwd=folder, capture_output=True, check=False)


def test_a_reader_that_leaves_early_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "seqid_cli", "completion", "bash"]
    with os.fdopen(write, "wb") as closed:
        done = subprocess.run(
            command, stdout=closed, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (0, "")
