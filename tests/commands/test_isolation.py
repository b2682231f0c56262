"""No command talks to the network or starts a program (SECURITY.md)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


def test_the_whole_way_keeps_to_itself(tmp_path: Path) -> None:
    robot, out = str(SAMPLES / "robot.toml"), str(tmp_path)
    done = watched("run", str(SAMPLES), "-r", robot, "-o", out)
    assert done.returncode == 0, done.stderr
    assert "FORBIDDEN" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("inspect", str(SAMPLES)),
        ("compare", str(SAMPLES / "golden.json"), str(SAMPLES / "golden.json")),
        ("init", str(SAMPLES / "friction")),
    ],
    ids=lambda arguments: arguments[0],
)
def test_so_do_the_others(arguments: tuple[str, ...]) -> None:
    done = watched(*arguments)
    assert done.returncode in (0, 1, 2), done.stderr
    assert "FORBIDDEN" not in done.stderr
