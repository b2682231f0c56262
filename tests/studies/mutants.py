"""Do the tests notice when a number that decides is another? `make mutants`.

Modules that decide are changed one place at a time by the operators of Cosmic Ray
(comparisons, arithmetic, constants, branches), in a copy of the tree, and the fast
tests of the module are run. A change that no test notices survives. A sample is drawn
by a seed: all mutants would take days.

Run by the environment that holds Cosmic Ray, which has nothing else of the project:

    python tests/studies/mutants.py --python .venv/bin/python --each 12 --seed 0
"""

import argparse
import ast
import importlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
# What is copied: the package, its tests, and what these read.
COPIED = ("seqid", "seqid_cli", "tests", "sample_logs", "docs", "pyproject.toml")
# Operations that fail on any number: their mutants would make the score too good.
LEFT_OUT = ("LShift", "RShift", "BitAnd", "BitOr", "BitXor", "Is", "IsNot")
TIMES = 4.0  # the time of the tests without a mutant: beyond, a mutant is killed


@dataclass(frozen=True)
class Module:
    """A module that decides, and its fast tests."""

    path: str
    tests: tuple[str, ...]


MODULES = (
    Module(
        "seqid_cli/identify/regression/least_squares.py",
        ("tests/unit/identify/regression",),
    ),
    Module(
        "seqid_cli/identify/regression/slow_noise.py",
        ("tests/unit/identify/regression/test_slow_noise.py",),
    ),
    Module(
        "seqid_cli/identify/regression/repeats.py",
        ("tests/unit/identify/regression/test_repeats.py",),
    ),
    Module(
        "seqid_cli/discover/select/bounds.py",
        ("tests/unit/discover/select/test_bounds.py",),
    ),
    Module(
        "seqid_cli/discover/select/linear.py",
        ("tests/unit/discover/select/test_linear.py",),
    ),
    Module(
        "seqid_cli/logs/messages/cdr.py",
        ("tests/unit/logs/mcap", "tests/unit/logs/test_formats.py"),
    ),
    Module(
        "seqid_cli/logs/tables/parquet_footer.py",
        (
            "tests/unit/logs/tables/test_parquet_footer.py",
            "--deselect=tests/unit/logs/tables/test_parquet_footer.py"
            "::test_few_bytes_that_stand_for_many_values_are_refused",
        ),
    ),
    Module(
        "seqid_cli/identify/judging.py",
        ("tests/unit/identify/test_judge.py",),
    ),
    Module("seqid_cli/settings.py", ("tests/unit/test_settings.py",)),
)


@dataclass(frozen=True)
class Mutant:
    """One change: the whole text, and where it differs."""

    text: str
    change: str


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", type=Path, required=True, help="of the tests")
    parser.add_argument("--each", type=int, default=12, help="mutants of a module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="modules with this in their path")
    chosen = parser.parse_args()
    python = chosen.python.absolute()

    sys.stdout.write("| module | mutants | killed | score |\n")
    sys.stdout.write("| --- | ---: | ---: | ---: |\n")
    survived: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        _copy_tree(copy)
        for module in MODULES:
            if chosen.only not in module.path:
                continue
            mutants = drawn(module.path, chosen.each, chosen.seed)
            seconds = _time(copy, python, module)
            left = [
                mutant.change
                for mutant in mutants
                if not _is_killed(copy, python, module, mutant, TIMES * seconds)
            ]
            survived += [f"{module.path}: {change}" for change in left]
            killed = len(mutants) - len(left)
            share = f"{100.0 * killed / max(len(mutants), 1):.0f} %"
            sys.stdout.write(
                f"| `{module.path}` | {len(mutants)} | {killed} | {share} |\n"
            )
            sys.stdout.flush()
    for line in survived:
        sys.stdout.write(f"survived: {line}\n")
    return 0


def drawn(path: str, count: int, seed: int) -> list[Mutant]:
    """Return some mutants of a module, the same ones for a seed."""
    source = (ROOT / path).read_text(encoding="utf-8")
    every = list(_occurrences(source))
    random.Random(f"{seed} {path}").shuffle(every)
    found: list[Mutant] = []
    for operator, occurrence in every:
        text = _mutating().mutate_code(source, operator, occurrence)
        if text is None or _is_of_text(source, text) or not _is_of_code(source, text):
            continue
        found.append(Mutant(text, _change(source, text)))
        if len(found) == count:
            break
    return found


def _occurrences(source: str) -> Iterator[tuple[Any, int]]:
    """Yield every operator with the places that it would change."""
    plugins = importlib.import_module("cosmic_ray.plugins")
    trees = importlib.import_module("cosmic_ray.ast")
    nodes = list(trees.ast_nodes(trees.get_ast(source)))
    for name in plugins.operator_names():
        kind = plugins.get_operator(name)
        if kind.arguments() or name.rpartition("_")[2] in LEFT_OUT:
            continue
        operator = kind()
        places = sum(len(list(operator.mutation_positions(node))) for node in nodes)
        yield from ((operator, place) for place in range(places))


def _mutating() -> Any:
    # Cosmic Ray's plug-ins import each other: the parser must be there first.
    importlib.import_module("parso.python.tree")
    return importlib.import_module("cosmic_ray.mutating")


def _is_of_text(source: str, text: str) -> bool:
    """Return whether a change is of an import or a signature: nothing decides there."""
    (old, _), *_ = _changed_lines(source, text)
    stripped = old.strip()
    return stripped.startswith(("from ", "import ", "def ", "@"))


def _is_of_code(source: str, text: str) -> bool:
    """Return whether a changed text can be run, and differs beyond its annotations.

    A text that is no Python fails every test, as does an annotation that cannot be
    evaluated: both would make the score too good.
    """
    try:
        changed = ast.parse(text)
    except SyntaxError:
        return False
    sound = ast.parse(source)
    return ast.dump(_bare(changed)) != ast.dump(_bare(sound))


def _bare(tree: ast.Module) -> ast.Module:
    """Return a tree without its annotations."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            node.returns = None
        if isinstance(node, ast.arg):
            node.annotation = None
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
    return tree


def _change(source: str, text: str) -> str:
    (old, new), *_ = _changed_lines(source, text)
    return f"`{old.strip()}` as `{new.strip()}`"


def _changed_lines(source: str, text: str) -> list[tuple[str, str]]:
    pairs = zip(source.splitlines(), text.splitlines(), strict=False)
    return [(old, new) for old, new in pairs if old != new] or [("", "")]


def _copy_tree(copy: Path) -> None:
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, symlinks=True)
        else:
            shutil.copy(source, copy / name)


def _run(copy: Path, python: Path, tests: Sequence[str], seconds: float | None) -> bool:
    """Return whether the tests pass in time."""
    line = [str(python), "-m", "pytest", "-q", "-x", "-m", "not slow", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
    # What was compiled before a mutant has its date.
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    try:
        done = subprocess.run(
            [*line, "-p", "no:cacheprovider", "-p", "no:xdist"],
            cwd=copy,
            env=environment,
            capture_output=True,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def _time(copy: Path, python: Path, module: Module) -> float:
    """Return how long the tests of a module take; they have to pass."""
    before = os.times().elapsed
    if not _run(copy, python, module.tests, None):
        raise RuntimeError(f"the tests of {module.path} fail without a mutant")
    return os.times().elapsed - before


def _is_killed(
    copy: Path, python: Path, module: Module, mutant: Mutant, seconds: float
) -> bool:
    target = copy / module.path
    sound = target.read_text(encoding="utf-8")
    target.write_text(mutant.text, encoding="utf-8")
    try:
        return not _run(copy, python, module.tests, max(seconds, 30.0))
    finally:
        target.write_text(sound, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
