"""A program of its own: streams that are full, closed or ASCII, names of any bytes, signals."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import ROOT

SAMPLES = ROOT / "sample_logs" / "one_joint"
FRICTION = SAMPLES / "friction"
ROBOT = ("-r", str(SAMPLES / "robot.toml"))
FULL = Path("/dev/full")
SEQID = (sys.executable, "-m", "seqid_cli")

pytestmark = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")


def started(*arguments: str | bytes, **more: object) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **dict(more.pop("env", {}))}  # type: ignore[call-overload]
    given: dict[str, object] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
    return subprocess.Popen([*SEQID, *arguments], env=environment, **given)  # type: ignore[call-overload]


def ran(*arguments: str | bytes, **more: object) -> tuple[int, str, str]:
    process = started(*arguments, **more)
    out, err = process.communicate(timeout=60)
    return process.returncode, (out or b"").decode(), (err or b"").decode()


@pytest.mark.parametrize(
    "arguments", [("inspect", str(SAMPLES)), ("completion", "bash"), ("--help",), ("--version",)]
)
def test_a_full_output_is_said_in_one_line(arguments: tuple[str, ...]) -> None:
    with FULL.open("wb") as full:
        code, _, err = ran(*arguments, stdout=full)
    assert code == 2
    assert "standard output cannot be written: No space left" in err
    assert "Traceback" not in err
    assert "bug" not in err


@pytest.mark.slow
@pytest.mark.parametrize("where", ["1>&-", "2>&-", "1>&- 2>&-", "2>/dev/full", "2> >(exec true)"])
def test_streams_that_nobody_can_read_cost_no_result(where: str, tmp_path: Path) -> None:
    made = tmp_path / "f.json"
    line = " ".join([*SEQID, "friction", str(FRICTION), *ROBOT, "-o", str(made), where])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["bash", "-c", line], env=environment, capture_output=True, timeout=60)
    assert done.returncode == 0
    assert (b"joint_1" in done.stdout) == ("1>&-" not in where)
    assert made.stat().st_size > 1000


@pytest.mark.slow
def test_a_variable_for_builds_does_no_harm(tmp_path: Path) -> None:
    code, _, err = ran("inspect", str(FRICTION), env={"SOURCE_DATE_EPOCH": "today"})
    assert code == 0, err


@pytest.mark.slow
@pytest.mark.parametrize("env", [{}, {"LC_ALL": "C", "PYTHONUTF8": "0"}], ids=["utf-8", "ascii"])
@pytest.mark.parametrize("name", ["gelenk_ö.parquet".encode(), b"log_\xff.parquet"])
def test_a_name_of_any_bytes_is_read_and_written(
    name: bytes, env: dict[str, str], tmp_path: Path
) -> None:
    (source,) = FRICTION.glob("*.parquet")
    log = os.path.join(os.fsencode(tmp_path), name)  # noqa: PTH118
    shutil.copy(os.fsencode(source), log)
    made = log.replace(b".parquet", b".json")
    code, out, err = ran("friction", log, *ROBOT, "-o", made, env=env)
    assert code == 0, err
    assert os.stat(made).st_size > 1000  # noqa: PTH116
    assert "joint_1" in out
    assert "Traceback" not in err


@pytest.mark.parametrize("place", ["log", "output"])
def test_a_pipe_is_refused_at_once(place: str, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.parquet"
    os.mkfifo(pipe)
    log, output = (pipe, tmp_path / "x.json") if place == "log" else (FRICTION, pipe)
    code, _, err = ran("friction", str(log), *ROBOT, "-o", str(output))
    assert code == 2
    assert "is no regular file" in err
    assert str(pipe) in err


def wait_for_work(process: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait until a process has used so much CPU time: how busy others are does not matter."""
    ticks = os.sysconf("SC_CLK_TCK")
    while process.poll() is None:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        if sum(map(int, fields[11:13])) >= seconds * ticks:
            return
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc on this system")
@pytest.mark.parametrize(("name", "after"), [("SIGTERM", 1.5), ("SIGHUP", 0.5), ("SIGINT", 0.2)])
def test_signals_end_it_like_an_interrupt(name: str, after: float, tmp_path: Path) -> None:
    """At work, and during the imports."""
    number = getattr(signal, name)
    made, changed = tmp_path / "r.json", ROOT / "sample_logs" / "two_joint" / "changed"
    held_out, model = changed / "held_out.parquet", changed.parent / "golden.json"
    process = started(
        *("refine", str(changed / "fourier.parquet"), "--holdout", str(held_out)),
        *("-r", str(changed.parent / "robot.toml"), "-p", str(model), "-o", str(made)),
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # not so in the background
    )
    wait_for_work(process, after)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.decode().endswith("interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path: Path) -> None:
    made = tmp_path / "f[1].json"
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = tmp_path / f".{made.name}.{gone.pid}.tmp"
    running = tmp_path / f".{made.name}.{os.getpid()}.tmp"
    for path in (left, running):
        path.write_text("half")
    code, _, err = ran("friction", str(FRICTION), *ROBOT, "-o", str(made))
    assert code == 0, err
    assert not left.exists()
    assert running.exists()
    assert made.stat().st_size > 1000
