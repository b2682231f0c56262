"""From the first line: help, examples and completion; nothing heavy is imported before
its time.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli import __version__
from seqid_cli.commands.app import COMMANDS, load_command
from seqid_cli.commands.completion import all_words, script
from tests import ROOT
from tests.commands.conftest import Rig


def test_the_overview_lists_every_command(rig: Rig) -> None:
    done = rig.run("--help")
    assert done.code == 0
    for name, (_, text) in COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(text)}$", done.out, re.MULTILINE)
    assert rig.run("-h").out == done.out
    nothing = rig.run()
    assert (nothing.code, nothing.out) == (2, "")
    assert "Commands:" in nothing.err


def test_the_overview_tells_the_order_of_work_and_all_formats(rig: Rig) -> None:
    text = rig.run("--help").out
    order = text.partition("Order of work:\n")[2]
    named = [word for word in re.findall(r"[a-z-]+", order) if word in COMMANDS]
    first = ["init", "inspect", "simultaneous", "run", "friction", "gravity"]
    assert named[: len(first)] == first
    formats = ("MCAP", "ROS 1 and 2 bags", "Parquet", "CSV", "LeRobot")
    for name in ("", "inspect", "simultaneous", "payload"):
        said = " ".join(rig.run(*filter(None, [name]), "--help").out.split())
        assert all(each in said for each in formats), name


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_common_flags_and_two_examples(
    rig: Rig, name: str
) -> None:
    """They parse, and name sample logs that exist."""
    text = rig.run(name, "--help").out
    for flag in ("-q, --quiet", "-v, --verbose", "--json", "--no-color", "--debug"):
        assert flag in text
    examples = re.findall(r"^ +(seqid .*)$", text.partition("Examples:\n")[2], re.M)
    assert len(examples) >= 2
    for example in examples:
        words = shlex.split(example.partition(" > ")[0])
        assert words[:2] == ["seqid", name]
        with load_command(name).make_context(name, words[2:]) as context:
            assert context.params
        named = [word for word in words if word.startswith("sample_logs/")]
        assert all(list(ROOT.glob(word)) for word in named), example
        assert named or name in ("completion", "report")


def complete(*words: str) -> list[str]:
    """Ask bash what it offers for the last of the words."""
    program = (
        script("bash", all_words())
        + f"COMP_WORDS=({' '.join(shlex.quote(word) for word in words)})\n"
        + f"COMP_CWORD={len(words) - 1}\n_seqid\n"
        + 'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes() -> None:
    assert complete("seqid", "gra") == ["gravity"]
    assert set(COMMANDS) <= set(complete("seqid", ""))
    assert complete("seqid", "predict", "--tor") == ["--torques"]
    assert complete("seqid", "friction", "a.mcap", "--time", "") == ["header", "log"]
    assert complete("seqid", "completion", "z") == ["zsh"]
    assert complete("seqid", "friction", "") == []  # files
    assert complete("seqid", "friction", "a", "-o", "-") == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_are_valid_and_name_every_command(shell: str) -> None:
    text = script(shell, all_words())
    for name in COMMANDS:
        assert name in text
    assert "torques" in text
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    subprocess.run([shell, "-n"], input=text, text=True, check=True)


def test_a_script_is_a_document_where_that_is_asked_for(rig: Rig) -> None:
    document = json.loads(rig.run("completion", "bash", "--json").out)
    assert document == {"shell": "bash", "script": script("bash", all_words())}


HEAVY = {
    "numpy", "scipy", "pinocchio", "pyarrow", "mcap", "mcap_ros2", "rich", "pydantic",
    "matplotlib",
}  # fmt: skip
LIST_MODULES = (
    "import json, sys\n"
    "from seqid_cli.__main__ import main\n"
    "codes = [main(line) for line in json.loads(sys.argv[1])]\n"
    "sys.stderr.write('\\n' + json.dumps([codes, sorted(sys.modules)]))\n"
)


def run(folder: Path, *asked: list[str]) -> tuple[list[int], str, set[str]]:
    """Exit codes of command lines, their output, and what one process imported for all
    of them.
    """
    command = [sys.executable, "-c", LIST_MODULES, json.dumps(asked)]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=True
    )
    codes, modules = json.loads(done.stderr.splitlines()[-1])
    return codes, done.stdout, {name.split(".")[0] for name in modules}


def test_the_first_line_is_light(tmp_path: Path) -> None:
    """All in one process: what it has imported in the end is all that any of them
    imports.
    """
    codes, out, modules = run(tmp_path, ["--version"])
    assert (codes, out) == ([0], f"seqid {__version__}\n")
    assert not modules & (HEAVY | {"typer", "msgspec"})
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
    [
        "refine",
        "good.parquet",
        "--holdout",
        "good.parquet",
        "-r",
        "bad.toml",
        "-p",
        "bad.json",
    ],
    [
        "refine",
        "good.parquet",
        "--holdout",
        "other.parquet",
        "-r",
        "bad.toml",
        "-p",
        "no.json",
    ],
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


# More than half of what a command takes for a log of minutes, if it needs them or not:
# SciPy, functions of Arrow that are made one by one, other formats, other commands.
BY_NEED = {"scipy", "pyarrow.compute", "mcap", "sqlite3", "seqid_cli.discover"}
# IMUs are smoothed by a band of equations.
WITH_IMUS = {f"scipy.{x}" for x in ("signal", "stats", "optimize", "interpolate")}
WITH_IMUS |= {f"scipy.{x}" for x in ("fft", "ndimage", "special", "sparse", "spatial")}
WITH_IMUS |= BY_NEED - {"scipy"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "unneeded"),
    [
        ("inspect {}/gravity", BY_NEED),
        ("simultaneous {}/inertia", BY_NEED),
        ("predict {}/validation", WITH_IMUS),
    ],
)
def test_stages_import_what_they_need(
    command: str, unneeded: set[str], tmp_path: Path
) -> None:
    rig = ROOT / "sample_logs" / "one_joint"
    words = [*command.format(rig).split(), "-r", str(rig / "robot.toml"), "--json"]
    words += ["-p", str(rig / "golden.json")] if words[0] == "predict" else []
    done = subprocess.run(
        [sys.executable, "-c", LIST_MODULES, json.dumps([words])],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    codes, modules = json.loads(done.stderr.splitlines()[-1])
    assert codes == [0]
    assert "numpy" in modules
    assert not unneeded & set(modules)


def test_rich_is_imported_where_a_table_is_drawn(tmp_path: Path) -> None:
    """Not with a command that prints JSON."""
    golden = str(ROOT / "sample_logs" / "one_joint" / "golden.json")
    compared = ["compare", golden, golden]
    codes, out, modules = run(tmp_path, [*compared, "--json"])
    assert codes == [0]
    assert out.startswith("{")
    assert "rich" not in modules
    codes, out, modules = run(tmp_path, compared)
    assert codes == [0]
    assert "friction" in out
    assert "rich" in modules
    assert "\x1b" not in out
