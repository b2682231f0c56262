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
from tests.unit.params.documents import friction_file, friction_stage, gravity_file

Replace = Callable[[str, str, object], list[object]]
FRICTION = ["friction", "a.parquet", "-r", "robot.toml", "-o", "out.json"]


GIVEN = "a.parquet -r robot.toml"
CANNOT_RUN = [
    ("frictoin", "seqid: error: no such command: frictoin", "Did you mean friction?"),
    ("friction", "seqid friction: error: Missing argument 'LOG...'", "--help"),
    ("friction a.parquet", "seqid friction: error: Missing option '-r' / '--robot'", "--help"),
    ("friction a -r r --cutof 3", "No such option: --cutof", "--help"),
    (f"friction {GIVEN} --cutoff 0", "0.0 is not a positive number", "--help"),
    (f"friction {GIVEN} --cutoff nan", "nan is not a positive number", "--help"),
    (f"friction {GIVEN} --time noon", "'noon' is not one of 'header', 'log'", "--help"),
    ("friction no -r robot.toml", "friction: error: no: does not exist", "Check"),
    ("friction a.parquet -r no.toml", "no.toml: ", ""),
    (f"friction {GIVEN} -o no/x.json", "no/x.json: its folder does not exist", "mkdir -p no"),
    (f"friction {GIVEN} -o a.parquet", "a.parquet: is an input of this command", "another"),
    (f"friction {GIVEN} -o robot.toml", "robot.toml: is an input of this command", "another"),
    (f"gravity {GIVEN} -p f.json -o f.json", "f.json: is an input of this command", "another"),
    (f"gravity {GIVEN} -p no.json", "no.json: does not exist", "-p"),
    (f"inertia {GIVEN} -p f.json", "f.json: there is no gravity stage", "Run seqid gravity first"),
    (f"inertia {GIVEN} -p g.json --motion imu", "g.json: there is no imu stage", "imu-calib first"),
    (f"gravity {GIVEN} -p g.json -p other.json", "other.json: is about robot 'leg'", "one robot"),
    (
        f"gravity {GIVEN} -p swapped.json",
        "swapped.json: is about robot 'arm' with joints elbow, shoulder, but robot.toml",
        "robot file",
    ),
]


@pytest.mark.parametrize(("line", "message", "hint"), CANNOT_RUN)
def test_what_cannot_run(rig: Rig, line: str, message: str, hint: str) -> None:
    rig.params("f.json", friction_file())
    rig.params("g.json", gravity_file())
    other = friction_file()
    other.robot.name = "leg"
    rig.params("other.json", other)
    swapped = friction_file()
    swapped.robot.joints = swapped.robot.joints[::-1]
    rig.params("swapped.json", swapped)

    done = rig.run(*line.split())
    assert (done.code, done.out) == (2, "")
    error, advice = done.err.splitlines()
    assert message in error
    assert advice.startswith("  hint: ")
    assert hint in advice
    assert "Traceback" not in done.err
    assert not (rig.folder / "out.json").exists()

    told = rig.run(*line.split(), "--json")
    assert told.code == 2
    assert json.loads(told.out)["error"]["code"] == 2


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


def test_an_interruption(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", KeyboardInterrupt())
    done = rig.run(*FRICTION)
    assert (done.code, done.err) == (130, "seqid friction: interrupted\n")
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
