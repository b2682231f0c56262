"""Every command, every piece of Python, every link of the documents.

Commands that take long are parsed here and run by `make docs-test`.
"""

import contextlib
import json
import os
import re
import shlex
import shutil
import subprocess
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

import seqid_cli
from seqid_cli.commands.app import COMMANDS
from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from tests.plants import so101, strangers
from tests.unit.docs import keys
from tests.unit.docs import kitchen as cooking
from tests.unit.docs.kitchen import (
    SAMPLES,
    Done,
    Kitchen,
    masked,
    parsed,
    read_by,
    rig_of,
)
from tests.unit.docs.markdown import PAGES, ROOT, Step, anchors, blocks, links, steps

NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Pages whose commands `make test` runs: the way of a user who has read no more.
FIRST = ("README.md", "docs/tutorial/first_model.md")
SO101 = "docs/how-to/so101.md"
FULL = bool(os.environ.get("SEQID_DOCS"))
LONG = pytest.mark.skipif(not FULL, reason="takes more than a minute: make docs-test")
RUN = [
    name
    if name in FIRST
    else pytest.param(
        name, marks=[pytest.mark.slow, LONG] if name == SO101 else pytest.mark.slow
    )
    for name in NAMES
]
ABOUT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = ABOUT["project"]
SIX = SAMPLES / "six_joint"
# What stands for the files that a page takes for granted: their names in the page, and
# the samples.
PREPARED: dict[str, dict[str, Path]] = {
    # the simulated arm records the plan for minutes
    "docs/how-to/afternoon.md": {"recorded": SIX},
    "docs/how-to/own_robot.md": {
        **{
            f"logs/{x}": SIX / x
            for x in ("friction", "gravity", "imu", "inertia", "validation")
        },
        "my_arm.urdf": SIX / "six_joint.urdf",
    },
    "docs/reference/inspect.md python": {
        "run.parquet": SAMPLES / "one_joint" / "imu" / "joint_1_posture_1.parquet",
        "robot.toml": SAMPLES / "one_joint" / "robot.toml",
    },
}
STRANGERS = ("docs/how-to/from_files.md", "docs/how-to/robots.md")
# What the reader is told to write between two blocks, after the first TOML of the page.
COMPLETED: dict[str, dict[str, Path]] = {
    "docs/how-to/own_robot.md": {
        name: SIX / name for name in ("robot.toml", "six_joint.urdf")
    }
}
# Commands with made-up logs and files: they are parsed only.
MADE_UP = ("logs/monday", "logs/tuesday", "logs/friday", "LOG", "load.json")


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory: pytest.TempPathFactory) -> Kitchen:
    return Kitchen(tmp_path_factory.mktemp("docs"))


def prepared(kitchen: Kitchen, name: str) -> Path:
    folder = kitchen.page_folder(name.replace("/", "_"))
    if name.split()[0] in STRANGERS and not (folder / "arm.urdf").exists():
        made = kitchen.folder / "strangers"
        if not made.exists():
            made.mkdir()
            strangers.make(made)
        shutil.copytree(made, folder, dirs_exist_ok=True)
    if name == SO101 and not (folder / "so101").exists():
        so101.make(folder / "so101")
    for path, sample in PREPARED.get(name, {}).items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists():
            (
                shutil.copytree(sample, target)
                if sample.is_dir()
                else shutil.copy(sample, target)
            )
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_commands_are_what_the_program_takes(name: str) -> None:
    checks = {"seqid": _check_seqid, "pip": _check_pip, "python": _check_module}
    for step in steps(ROOT / name):
        if step.words[0] == "make":
            made_by(*step.words[1:])
        elif check := checks.get(step.words[0]):
            check(step)


def made_by(*words: str, folder: Path = ROOT) -> str:
    command = ["make", "-n", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, f"{words}\n{done.stderr}"
    return done.stdout


def _check_seqid(step: Step) -> None:
    words, _ = _redirected(step.words[1:])
    if words in (("--help",), ("--version",)):
        return
    assert words[0] in COMMANDS, str(step)
    if "--show-settings" in words:  # which asks for nothing else
        assert words[0] in SETTINGS_OF_COMMANDS, str(step)
    parsed(words)
    for path in read_by(words):
        if path.startswith("sample_logs/"):
            assert list(ROOT.glob(path)), f"{step}: there is no {path}"


def _check_pip(step: Step) -> None:
    assert step.words[1] == "install", str(step)
    for word in step.words[2:]:
        asked = re.fullmatch(r"(?:\.|seqid|-e)(?:\[(\w+)\])?", word)
        assert asked, str(step)
        assert asked[1] is None or asked[1] in PROJECT["optional-dependencies"], str(
            step
        )


def _check_module(step: Step) -> None:
    if step.words[1] != "-m":
        return
    found = find_spec(step.words[2])
    assert found is not None, str(step)
    places = found.submodule_search_locations
    files = sorted(Path(places[0]).rglob("*.py")) if places else [Path(found.origin)]
    source = "".join(file.read_text(encoding="utf-8") for file in files)
    for word in step.words[3:]:
        assert not word.startswith("--") or f'"{word}"' in source, f"{step}: no {word}"


@pytest.mark.parametrize("name", RUN)
def test_commands_do_what_the_page_says(name: str, kitchen: Kitchen) -> None:
    folder = prepared(kitchen, name)
    said: list[str] = []
    rig = "six_joint" if name in COMPLETED else "one_joint"
    tables = [block.line for block in blocks(ROOT / name) if block.language == "toml"]
    for step in steps(ROOT / name):
        if step.words[0] != "seqid" or step.words[1].startswith("-"):
            continue
        if tables and step.line > tables[0]:
            for path, sample in COMPLETED.get(name, {}).items():
                shutil.copy(sample, folder / path)
        rig = rig_of(step.words, rig)
        done = _cooked(kitchen, folder, step, rig)
        said += done.said.splitlines() if done else []
        if done and step.shown:
            _check_shown(step, said)
        said = [] if step.shown else said


def _cooked(kitchen: Kitchen, folder: Path, step: Step, rig: str) -> Done | None:
    """Run a step if it is to be run; put in its place what later steps need of it."""
    words, target = _redirected(step.words[1:])
    if any(word.startswith(MADE_UP) for word in words):
        return None
    if cooking.is_dear([*words, rig]) and not FULL:
        for path in cooking.written_by(words):
            if path.endswith(".json") and "diagnosis" not in path:
                kitchen.fetch(folder, path, rig)
        return None
    made = FULL or rig == "one_joint"  # else a diagnosis takes too long
    words = tuple(
        w for w in words if made or "diagnosis" not in w or (folder / w).exists()
    )
    for path in read_by(words):
        if not list(folder.glob(path)) and path.endswith((".json", "torques.parquet")):
            kitchen.fetch(folder, path, rig)
    done = kitchen.cook(
        folder, [path for word in words for path in _expanded(folder, word)]
    )
    assert done.code == step.exit_code, f"{step}\n{done.said}"
    if target:
        (folder / target).write_text(done.out, encoding="utf-8")
    return done


def _redirected(words: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    if ">" not in words:
        return words, ""
    at = words.index(">")
    return words[:at], "" if words[at + 1].startswith("~") else words[at + 1]


def _expanded(folder: Path, word: str) -> list[str]:
    paths = folder.glob(word) if "*" in word else ()
    return sorted(str(path.relative_to(folder)) for path in paths) or [word]


def _check_shown(step: Step, said: list[str]) -> None:
    real = [masked(line) for line in said]
    for line in step.shown:
        shown = masked(line)
        start = shown.removesuffix(" ...")
        cut = [x for x in real if start != shown and x.startswith(start)]
        assert cut or shown in (
            "",
            "...",
            *real,
        ), f"{step}\ndoes not say: {line}\nbut:\n" + "\n".join(said)


@pytest.mark.parametrize("name", RUN)
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_python_runs(name: str, kitchen: Kitchen) -> None:
    folder = prepared(kitchen, f"{name} python")
    space: dict[str, object] = {}
    for block in blocks(ROOT / name):
        imports = block.language == "indented" and re.match(
            r"(from|import) \w", block.text
        )
        if block.language != "python" and not imports:
            continue
        for path in re.findall(
            r'"([\w/]+\.json|\w+\.urdf|torques.parquet)"', block.text
        ):
            if not (folder / path).exists():
                kitchen.fetch(folder, path, rig_of([block.text]))
        code = compile("\n" * (block.line - 1) + block.text, str(block.page), "exec")
        with contextlib.chdir(folder):
            exec(code, space)


@pytest.mark.parametrize("name", NAMES)
def test_data_can_be_read_and_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for block in blocks(page):
        if block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "json":
            json.loads(block.text)
    for link in links(page):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{name}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{name}: {link}"


def test_the_keys_of_the_files_are_told() -> None:
    text = keys.PAGE.read_text(encoding="utf-8")
    assert keys.rewritten(text) == text, (
        "run python -m tests.unit.docs.keys and say what is new"
    )
    assert "TODO" not in text
    told = {name for name, _ in keys.TABLE.findall(text)}
    assert told | set(keys.INLINE) == set(keys.STRUCTS)


def test_the_makefile_of_the_page_runs_what_the_program_takes(tmp_path: Path) -> None:
    page = ROOT / "docs" / "how-to" / "pipelines.md"
    text = next(block.text for block in blocks(page) if block.language == "make")
    (tmp_path / "Makefile").write_text(text + "\n", encoding="utf-8")
    shutil.copytree(SAMPLES / "one_joint", tmp_path / "robots" / "arm")
    lines = made_by(folder=tmp_path).splitlines()
    ran = [shlex.split(line)[1:] for line in lines if line.startswith("seqid")]
    assert [words[0] for words in ran][:3] == ["friction", "gravity", "inertia"]
    assert {words[0] for words in ran[3:]} == {"predict", "diagnose", "report"}
    for words in ran:
        parsed(words)
        named = [path for path in read_by(words) if path.startswith("robots")]
        assert all((tmp_path / path).exists() for path in named)


def test_every_function_is_told() -> None:
    text = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    told = set(re.findall(r"^\| `(\w+\.\w+)` \|", text, flags=re.MULTILINE))
    names = {name.replace("-", "_") for name in COMMANDS}
    there = {
        f"{package}.{name}"
        for package in seqid_cli.PACKAGES
        for name in names
        if callable(getattr(getattr(seqid_cli, package), name, None))
    }
    assert told == there


WORKFLOW = (ROOT / ".github" / "workflows" / "seqid.yml").read_text(encoding="utf-8")


def test_the_workflow_makes_targets_that_there_are() -> None:
    targets = re.findall(r"run: make ([\w-]+)", WORKFLOW)
    always = {"lint", "types", "test-all", "golden", "docs-test"}
    assert set(targets) == always | {"locked", "test-oldest", "audit", "sbom", "fuzz"}
    for target in targets:
        made_by(target)


def test_actions_are_pinned_and_dependencies_locked() -> None:
    actions = re.findall(r"uses: (\S+)", WORKFLOW)
    assert actions
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in actions)
    lock = (ROOT / ".ci" / "requirements.txt").read_text(encoding="utf-8")
    blocks = re.split(r"\n(?=\S)", lock.strip())
    assert all("--hash=sha256:" in block for block in blocks)
    assert "://" not in lock
    locked = {re.split(r"[=\[ ]", block)[0] for block in blocks}
    wanted = [*PROJECT["dependencies"], *ABOUT["build-system"]["requires"]]
    wanted += PROJECT["optional-dependencies"]["dev"]
    assert {re.split(r"[<>=\[]", name)[0] for name in wanted} <= locked


def test_the_first_page_names_every_command_and_links_every_page() -> None:
    first = (ROOT / "README.md").resolve()
    text = first.read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"| `{name}` |" not in text] == []
    linked = {(ROOT / link.partition("#")[0]).resolve() for link in links(first)}
    layouts = ROOT / "docs" / "how-to" / "layouts" / "README.md"
    assert {page.resolve() for page in PAGES} - linked <= {first, layouts.resolve()}


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("docs/")])
def test_a_page_says_first_who_it_is_for(name: str) -> None:
    paragraphs = (ROOT / name).read_text(encoding="utf-8").split("\n\n")
    assert paragraphs[0].startswith("# ")
    reader = r"\b(for (whoever|readers|those)|you)\b"
    assert re.search(reader, paragraphs[1], re.IGNORECASE), paragraphs[1]


def test_the_paths_of_the_map_exist() -> None:
    architecture = (
        (ROOT / "README.md").read_text(encoding="utf-8").split("## Architecture")[1]
    )
    rows = re.findall(r"^\|.*", architecture.split("## ")[0], flags=re.MULTILINE)
    paths = re.findall(r"`([\w/.]+(?:/|\.py|\.j2))`", "\n".join(rows))
    assert len(paths) > 20
    for path in paths:
        assert path == "seqid_cli/" or (ROOT / "seqid_cli" / path).exists(), path


FIGURES = re.compile(r"<!-- figures of (\S+) -->\n((?:\|.*\n)+)")
RESULTS = ROOT / "docs" / "results.md"


def numbers(text: str) -> set[str]:
    return set(re.findall(r"\d+(?:\.\d+)?", text))


def test_the_figures_of_the_results_are_those_of_the_evidence() -> None:
    """Every number of a table of results stands in the tables of the page it names."""
    tables = FIGURES.findall(RESULTS.read_text(encoding="utf-8"))
    assert len(tables) >= 7
    for page, rows in tables:
        evidence = (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines()
        known = numbers("\n".join(line for line in evidence if line.startswith("|")))
        for row in rows.splitlines()[2:]:
            cells = " ".join(row.split("|")[2:])
            assert numbers(cells) <= known, f"{page}: {row}"


def test_the_figures_of_the_first_page_are_those_of_the_results() -> None:
    """The first table of README stands in the results, which the studies back."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?:FIGAROH|seqid), .*\|$", text, flags=re.MULTILINE)
    results = RESULTS.read_text(encoding="utf-8").splitlines()
    assert len(rows) == 4
    assert set(rows) <= set(results)


def test_the_simulated_arms_of_the_results_are_those_of_the_study() -> None:
    """The rows of simulated arms stand in the tables that the study writes."""
    label = {
        "seqid, one stage after the other": "sequential, sliding",
        "everything in one least squares": "simultaneous, sliding",
        "noise of the currents alone": "current noise alone",
    }
    measured = ROOT / "docs" / "evidence" / "measured.md"
    written = measured.read_text(encoding="utf-8").splitlines()
    results = RESULTS.read_text(encoding="utf-8")
    for name, row in label.items():
        found = re.search(rf"^\| {name} (\|.*)$", results, flags=re.MULTILINE)
        assert found, name
        assert f"| {row} {found[1]}" in written
