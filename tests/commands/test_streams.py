"""A program among others: streams, names of any bytes, signals; no way out in the
source.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import ROOT
from tests.commands.conftest import ONE_JOINT, SAMPLE_LOGS, Rig

FRICTION = ONE_JOINT / "friction"
GRAVITY = ONE_JOINT / "gravity"  # one short log
ROBOT = ("-r", str(ONE_JOINT / "robot.toml"))
FULL = Path("/dev/full")
SEQID = (sys.executable, "-m", "seqid_cli")

pytestmark = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")


def started(*arguments: str | bytes, **more: object) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **dict(more.pop("env", {}))}  # type: ignore[call-overload]
    given: dict[str, object] = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        **more,
    }
    return subprocess.Popen([*SEQID, *arguments], env=environment, **given)  # type: ignore[call-overload]


def ran(*arguments: str | bytes, **more: object) -> tuple[int, str, str]:
    process = started(*arguments, **more)
    out, err = process.communicate(timeout=60)
    return process.returncode, (out or b"").decode(), (err or b"").decode()


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [("inspect", str(GRAVITY)), ("completion", "bash"), ("--help",), ("--version",)],
)
def test_a_full_output_is_said_in_one_line(arguments: tuple[str, ...]) -> None:
    with FULL.open("wb") as full:
        code, _, err = ran(*arguments, stdout=full)
    assert code == 2
    assert "standard output cannot be written: No space left" in err
    assert "Traceback" not in err
    assert "bug" not in err


@pytest.mark.slow
@pytest.mark.parametrize(
    "where", ["1>&-", "2>&-", "1>&- 2>&-", "2>/dev/full", "2> >(exec true)"]
)
def test_streams_that_nobody_can_read_cost_no_result(
    where: str, tmp_path: Path
) -> None:
    made = tmp_path / "f.json"
    line = " ".join([*SEQID, "inspect", str(GRAVITY), *ROBOT, "-o", str(made), where])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-c", line], env=environment, capture_output=True, timeout=60
    )
    assert done.returncode == 0
    assert (b"joint_1" in done.stdout) == ("1>&-" not in where)
    assert made.stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    "env",
    [{"SOURCE_DATE_EPOCH": "1700000000"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}],
    ids=["utf-8, a date for all results", "ascii"],
)
def test_names_of_any_bytes_are_taken(env: dict[str, str], tmp_path: Path) -> None:
    (source,) = FRICTION.glob("*.parquet")
    folder = os.fsencode(tmp_path)
    names = ("gelenk_ö".encode(), b"log_\xff")
    logs = [os.path.join(folder, name + b".parquet") for name in names]  # noqa: PTH118
    for log in logs:
        shutil.copy(os.fsencode(source), log)
    made = os.path.join(folder, b"_".join(names) + b".json")  # noqa: PTH118
    code, out, err = ran("friction", *logs, *ROBOT, "-o", made, env=env)
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
    """Wait until the worker of a process has used so much CPU time: how busy others are
    does not matter.
    """
    ticks = os.sysconf("SC_CLK_TCK")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None:
        for worker in children.read_text().split():
            fields = Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()
            if sum(map(int, fields[11:13])) >= seconds * ticks:
                return
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="no /proc on this system"
)
@pytest.mark.parametrize(
    ("name", "after"), [("SIGTERM", 1.5), ("SIGHUP", 0.5), ("SIGINT", 0.2)]
)
def test_a_signal_at_work_interrupts(name: str, after: float, tmp_path: Path) -> None:
    number = getattr(signal, name)
    made, changed = tmp_path / "r.json", SAMPLE_LOGS / "two_joint" / "changed"
    held_out, model = changed / "held_out.parquet", changed.parent / "golden.json"
    process = started(
        *("refine", str(changed / "fourier.parquet"), "--holdout", str(held_out)),
        *("-r", str(changed.parent / "robot.toml"), "-p", str(model), "-o", str(made)),
        # not so in the background
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    wait_for_work(process, after)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.decode().endswith("interrupted\n")
    assert not list(tmp_path.iterdir())


IN_IMPORT = 'exec("import signal; signal.raise_signal(signal.{})")'
IN_FINALIZER = (
    "import time, weakref;weakref.finalize(completion, signal.raise_signal,"
    " signal.SIGTERM)(); time.sleep(20)"
)


@pytest.mark.parametrize(
    ("name", "before", "during", "code"),
    [
        ("SIGINT", "SIG_DFL", IN_IMPORT, 130),
        ("SIGTERM", "SIG_DFL", IN_IMPORT, 130),
        ("SIGTERM", "SIG_DFL", IN_FINALIZER, 130),
        ("SIGHUP", "SIG_IGN", IN_IMPORT, 0),
    ],
    ids=["interrupt", "end", "end in a finalizer", "one that the caller ignores"],
)
def test_no_signal_is_forgotten(
    name: str, before: str, during: str, code: int, tmp_path: Path
) -> None:
    """Python forgets interrupts in texts run by `exec` and exceptions in finalizers."""
    (tmp_path / "program.py").write_text(f"""
import signal, sys
import seqid_cli.commands.completion as completion
# Tests that run in the background ignore some signals.
signal.signal(signal.{name}, signal.{before})
words = completion.all_words()
def interrupted():
    {during.format(name)}
    return words
completion.all_words = interrupted
sys.argv = ["seqid", "completion", "bash"]
from seqid_cli.__main__ import main
sys.exit(main())
""")
    # run as a script, Python forgets the interrupt
    command = [sys.executable, "-m", "program"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == code
    assert done.stderr == (b"seqid completion: interrupted\n" if code else b"")


def test_a_reader_that_leaves_early_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as closed:
        assert ran("completion", "bash", stdout=closed) == (0, "", "")


MODULES = (
    "socket|subprocess|pickle|shelve|marshal|ctypes|runpy|http|webbrowser|urllib|ftplib"
)
FORBIDDEN = re.compile(
    rf"^ *(?:import|from) (?:{MODULES}|smtplib|asyncio)\b"
    r"|(?<![\w.])(?:eval|exec|compile)\(|\bos\.(?:system|popen|exec)",
    flags=re.MULTILINE,
)


def test_the_source_has_no_way_out() -> None:
    """Nothing that starts programs, opens connections or runs what it reads.

    But for the replay of an export: it compiles, loads and imports the file that the
    same command has just written, and nothing else.
    """
    replay = ROOT / "seqid_cli" / "export" / "written" / "code.py"
    files = set((ROOT / "seqid_cli").rglob("*.py")) - {replay}
    found = {path.name: FORBIDDEN.findall(path.read_text("utf-8")) for path in files}
    assert [(name, ways) for name, ways in found.items() if ways] == []
    users = {
        str(path.relative_to(ROOT / "seqid_cli"))
        for path in files
        if "export.written.code import" in path.read_text("utf-8")
    }
    assert users == {"export/__init__.py", "export/written/read.py"}


@pytest.mark.slow
def test_a_plug_in_loads_only_when_it_is_named(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = rig.folder / "stranger-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Name: stranger\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[seqid.effects]\nstrange_drag = stranger:effect\n"
    )
    (rig.folder / "stranger.py").write_text("raise RuntimeError('was loaded')\n")
    monkeypatch.syspath_prepend(str(rig.folder))
    log, model = (
        str(ONE_JOINT / x) for x in ("changed/held_out.parquet", "golden.json")
    )
    given = (ONE_JOINT / "robot.toml").read_text()
    for more, loaded in (("", False), ('\n[[effect]]\nname = "strange_drag"\n', True)):
        (rig.folder / "robot.toml").write_text(given + more)
        done = rig.run("diagnose", log, "-r", "robot.toml", "-p", model)
        assert ("was loaded" in done.err) == loaded
