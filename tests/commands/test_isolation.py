"""No command talks to the network or starts a program (SECURITY.md)."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli.__main__ import main
from tests import ROOT

SAMPLES = ROOT / "sample_logs" / "one_joint"
WATCHED = """
import sys

def watch(event, arguments):
    if event.startswith(("socket.connect", "socket.bind", "socket.getaddrinfo", "subprocess.",
                         "os.system", "os.exec", "os.posix_spawn", "os.spawn", "pickle.find_class",
                         "urllib.", "ftplib.", "smtplib.", "webbrowser.")):
        sys.stderr.write(f"FORBIDDEN {event} {arguments}\\n")

sys.addaudithook(watch)
from seqid_cli.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def watched(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WATCHED, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


def test_the_watch_sees() -> None:
    text = WATCHED.replace("from seqid", "import os; os.system('true')\nfrom seqid")
    done = subprocess.run([sys.executable, "-c", text, "--version"], capture_output=True, text=True)
    assert "FORBIDDEN os.system" in done.stderr


@pytest.mark.slow
def test_the_whole_way_keeps_to_itself(tmp_path: Path) -> None:
    robot, out = str(SAMPLES / "robot.toml"), str(tmp_path)
    done = watched("run", str(SAMPLES), "-r", robot, "-o", out)
    assert done.returncode == 0, done.stderr
    assert "FORBIDDEN" not in done.stderr


FORBIDDEN = {  # what starts programs, opens connections or runs what it reads
    "socket", "subprocess", "pickle", "shelve", "marshal", "ctypes", "runpy", "http", "webbrowser",
    "urllib", "ftplib", "smtplib", "asyncio", "eval", "exec", "compile", "system", "popen", "execv",
}  # fmt: skip


def names_of(node: ast.AST) -> set[str]:
    if isinstance(node, ast.Import):
        return {alias.name.partition(".")[0] for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        return {str(node.module).partition(".")[0]}
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return {node.func.id}
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return {node.attr} if node.value.id == "os" else set()
    return set()


def test_the_source_has_no_way_out() -> None:
    found = {
        f"{path.name}: {name}"
        for path in (ROOT / "seqid_cli").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in names_of(node) & FORBIDDEN
    }
    assert not found


@pytest.mark.slow
def test_a_plug_in_loads_only_when_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    about = tmp_path / "stranger-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Name: stranger\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[seqid.effects]\nstrange_drag = stranger:effect\n")
    (tmp_path / "stranger.py").write_text("raise RuntimeError('was loaded')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    robot, log = tmp_path / "robot.toml", str(SAMPLES / "changed" / "held_out.parquet")
    given = (SAMPLES / "robot.toml").read_text()
    model = ("-p", str(SAMPLES / "golden.json"))
    for more, loaded in (("", False), ('\n[[effect]]\nname = "strange_drag"\n', True)):
        robot.write_text(given + more)
        main(["diagnose", log, "-r", str(robot), *model])
        assert ("was loaded" in capsys.readouterr().err) == loaded
