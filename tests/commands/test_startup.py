"""What a command line imports: nothing heavy before there is something to compute."""

import json
import subprocess
import sys
from pathlib import Path

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
    "import json, sys\n"
    "from seqid_cli.__main__ import main\n"
    "codes = [main(line) for line in json.loads(sys.argv[1])]\n"
    "sys.stderr.write('\\n' + json.dumps([codes, sorted(sys.modules)]))\n"
)


def run(folder: Path, *asked: list[str]) -> tuple[list[int], str, set[str]]:
    """Exit codes of command lines, their output, and what one process imported for all of them."""
    command = [sys.executable, "-c", LIST_MODULES, json.dumps(asked)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    codes, modules = json.loads(done.stderr.splitlines()[-1])
    return codes, done.stdout, {name.split(".")[0] for name in modules}


def test_the_version_needs_no_typer(tmp_path: Path) -> None:
    codes, out, modules = run(tmp_path, ["--version"])
    assert (codes, out) == ([0], f"seqid {__version__}\n")
    assert not modules & (HEAVY | {"typer", "msgspec"})


def test_help_and_completion_are_light(tmp_path: Path) -> None:
    """All in one process: what it has imported in the end is all that any of them imports."""
    asked = [["--help"], *([name, "-h"] for name in COMMANDS)]
    asked += [["completion", shell] for shell in ("bash", "zsh", "fish")]
    codes, out, modules = run(tmp_path, *asked)
    assert codes == [0] * len(asked)
    assert out.count("Usage: seqid") == 1 + len(COMMANDS)
    assert not modules & HEAVY


MISTAKES = [
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
]


def test_mistakes_are_found_before_heavy_imports(tmp_path: Path) -> None:
    (tmp_path / "empty.parquet").touch()
    (tmp_path / "good.parquet").write_bytes(b"PAR1" + b"\0" * 16 + b"PAR1")
    (tmp_path / "other.parquet").write_bytes(b"PAR1" + b"\1" * 16 + b"PAR1")
    (tmp_path / "bad.toml").write_text("schema = ")
    (tmp_path / "bad.json").write_text("{")
    codes, out, modules = run(tmp_path, *MISTAKES)
    assert (codes, out) == ([2] * len(MISTAKES), "")
    assert not modules & HEAVY
