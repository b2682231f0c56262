"""What a command line imports: nothing heavy before there is something to compute."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli import __version__
from seqid_cli.commands.app import COMMANDS

HEAVY = {
    "numpy",
    "scipy",
    "pinocchio",
    "pyarrow",
    "mcap",
    "mcap_ros2",
    "rich",
    "pydantic",
    "matplotlib",
}
LIST_MODULES = (
    "import atexit, json, sys\n"
    "atexit.register(lambda: sys.stderr.write('\\n' + json.dumps(sorted(sys.modules))))\n"
    "from seqid_cli.__main__ import main\n"
    "sys.exit(main(sys.argv[1:]))\n"
)


def run(folder: Path, *arguments: str) -> tuple[int, str, set[str]]:
    command = [sys.executable, "-c", LIST_MODULES, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    modules = json.loads(done.stderr.splitlines()[-1])
    return done.returncode, done.stdout, {name.split(".")[0] for name in modules}


def test_the_version_needs_no_typer(tmp_path: Path) -> None:
    code, out, modules = run(tmp_path, "--version")
    assert (code, out) == (0, f"seqid {__version__}\n")
    assert not modules & (HEAVY | {"typer", "msgspec"})


@pytest.mark.parametrize("arguments", [["--help"], *([name, "-h"] for name in COMMANDS)])
def test_help_is_light(tmp_path: Path, arguments: list[str]) -> None:
    code, out, modules = run(tmp_path, *arguments)
    assert code == 0
    assert "Usage: seqid" in out
    assert not modules & HEAVY


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_light(tmp_path: Path, shell: str) -> None:
    code, out, modules = run(tmp_path, "completion", shell)
    assert code == 0
    assert "friction" in out
    assert not modules & HEAVY


@pytest.mark.parametrize(
    "arguments",
    [
        ["friction", "no.parquet", "-r", "no.toml"],
        ["friction", "empty.parquet", "-r", "no.toml"],
        ["friction", "good.parquet", "-r", "no.toml"],
        ["friction", "good.parquet", "-r", "bad.toml"],
        ["friction", "good.parquet", "-r", "bad.toml", "-o", "no/out.json"],
        ["gravity", "good.parquet", "-r", "bad.toml", "-p", "no.json"],
        ["gravity", "good.parquet", "-r", "bad.toml", "-p", "bad.json"],
        ["predict", "good.parquet", "-r", "bad.toml", "-p", "bad.json", "--torques", "x/t"],
        ["diagnose", "good.parquet", "-r", "bad.toml", "-p", "bad.json"],
        ["refine", "good.parquet", "--holdout", "good.parquet", "-r", "bad.toml", "-p", "bad.json"],
        ["refine", "good.parquet", "--holdout", "other.parquet", "-r", "bad.toml", "-p", "no.json"],
        ["inertia"],
        ["frictoin"],
    ],
)
def test_mistakes_are_found_before_heavy_imports(tmp_path: Path, arguments: list[str]) -> None:
    (tmp_path / "empty.parquet").touch()
    (tmp_path / "good.parquet").write_bytes(b"PAR1" + b"\0" * 16 + b"PAR1")
    (tmp_path / "other.parquet").write_bytes(b"PAR1" + b"\1" * 16 + b"PAR1")
    (tmp_path / "bad.toml").write_text("schema = ")
    (tmp_path / "bad.json").write_text("{")
    code, out, modules = run(tmp_path, *arguments)
    assert (code, out) == (2, "")
    assert not modules & HEAVY
