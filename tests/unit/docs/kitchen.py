"""Runs the commands of the documents, each once, and keeps what they need at hand.

A page has a folder of its own with `sample_logs` in it. What a command reads and no command of the
page has made is made by the command that a user would have run before: the stages of `one_joint`
step by step, of `two_joint` from its golden file, of `six_joint` by the classical fit, which is
quick.
"""

import contextlib
import hashlib
import io
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from seqid_cli.__main__ import main
from seqid_cli.commands.app import load_command
from tests.unit.docs.markdown import ROOT

SAMPLES = ROOT / "sample_logs"
RIGS = ("one_joint", "two_joint", "six_joint")
WRITTEN = ("output", "torques")
READ = ("logs", "holdout", "robot", "parameters", "files", "first", "second", "urdf")
IDENTIFY = ("friction", "gravity", "imu-calib", "inertia", "simultaneous")
PREDICT = (
    "predict {r}/validation -r {r}/robot.toml -p inertia.json -o prediction.json"
    " --torques torques.parquet"
)
LOOKED_AT = ("prediction.json", "torques.parquet", "diagnosis.json")
# How the files of one_joint come about, each from the one before.
RECIPES = {
    "friction.json": "friction {r}/friction -r {r}/robot.toml -o friction.json",
    "gravity.json": "gravity {r}/gravity {r}/friction -r {r}/robot.toml -p friction.json"
    " -o gravity.json",
    "imu.json": "imu-calib {r}/imu -r {r}/robot.toml -p gravity.json -o imu.json",
    "inertia.json": "inertia {r}/inertia -r {r}/robot.toml -p imu.json -o inertia.json",
    "prediction.json": PREDICT,
    "torques.parquet": PREDICT,
    "diagnosis.json": "diagnose {r}/validation -r {r}/robot.toml -p inertia.json -o diagnosis.json",
}
EXPORT = "export inertia.json -r {r}/robot.toml -o {name}.urdf --json"
SIMULTANEOUS = "simultaneous {r}/inertia -r {r}/robot.toml -o inertia.json"


@dataclass(frozen=True)
class Done:
    """How a command ended: exit code, what it said, and the files that it wrote."""

    code: int
    said: str
    out: str
    files: dict[str, bytes]


@dataclass
class Kitchen:
    """Where commands run; the same one on the same files runs once."""

    folder: Path
    full: bool = False
    done: dict[tuple[str, ...], Done] = field(default_factory=dict)

    def page_folder(self, name: str) -> Path:
        """Return the folder of a page, made where it is not there."""
        path = self.folder / name
        if not path.exists():
            path.mkdir()
            (path / "sample_logs").symlink_to(SAMPLES)
        return path

    def cook(self, folder: Path, words: Sequence[str]) -> Done:
        """Run `seqid` with these words in a folder, or bring what it wrote the last time."""
        key = (*words, *_digests(folder, words))
        if key not in self.done:
            self.done[key] = _run(folder, words)
        done = self.done[key]
        for name, content in done.files.items():
            (folder / name).write_bytes(content)
        return done

    def fetch(self, folder: Path, name: str, rig: str) -> None:
        """Make a file that a command of the page reads."""
        path = Path(name)
        if path.parent.parts[:1] == ("out",):
            rig = path.parent.parts[1]
        own = self.page_folder(f"larder_{rig}")
        wanted = ["inertia.json", "prediction.json"] if path.name == "*.json" else [path.name]
        for item in wanted:
            self._larder(own, item, rig)
            target = folder / path.parent / item
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.exists():
                shutil.copy(own / item, target)

    def _larder(self, own: Path, name: str, rig: str) -> None:
        if (own / name).exists():
            return
        if name == "export.json" or name.endswith(".urdf"):
            self._larder(own, "inertia.json", rig)
            words = EXPORT.format(r=f"sample_logs/{rig}", name=rig).split()
            (own / "export.json").write_text(self.cook(own, words).out, encoding="utf-8")
            return
        usual = name if name in RECIPES else "inertia.json"  # a refined file is one as well
        if rig == "two_joint" and usual not in LOOKED_AT:
            shutil.copy(SAMPLES / rig / "golden.json", own / name)
            return
        recipe = RECIPES[usual]
        if rig == "six_joint" and usual not in LOOKED_AT:
            recipe = SIMULTANEOUS
        words = recipe.format(r=f"sample_logs/{rig}").split()
        if "-p" in words:
            self._larder(own, words[words.index("-p") + 1], rig)
        done = self.cook(own, words)
        assert done.code == 0, done.said
        if not (own / name).exists():
            shutil.copy(own / words[words.index("-o") + 1], own / name)


def rig_of(words: Sequence[str], default: str = "one_joint") -> str:
    """Return the sample robot that a command line is about."""
    return next((rig for rig in RIGS if any(rig in word for word in words)), default)


def is_dear(words: Sequence[str]) -> bool:
    """Return whether a command takes long: it is run by `make docs-test` alone."""
    rig = rig_of(words)
    if words[0] == "run":
        return rig == "six_joint"
    if words[0] in IDENTIFY:
        return rig != "one_joint"
    if words[0] == "diagnose":
        return rig != "one_joint" or not any("validation" in word for word in words)
    if words[0] in ("inspect", "init"):
        return rig == "six_joint" and not any("validation" in word for word in words)
    return words[0] == "refine"


def parsed(words: Sequence[str]) -> dict[str, Any]:
    """Return what the command takes from these words; wrong options raise."""
    with load_command(words[0]).make_context(words[0], list(words[1:])) as context:
        return dict(context.params)


RUNS_LAST = "report.html"  # that `run` writes into its folder


def read_by(words: Sequence[str]) -> Iterator[str]:
    """Yield the paths that a command reads."""
    asked = parsed(words)
    for name in (*READ, "torques") if words[0] == "report" else READ:
        value = asked.get(name)
        for item in value if isinstance(value, list | tuple) else [value]:
            if item is not None:
                yield str(item)


def written_by(words: Sequence[str]) -> list[str]:
    """Return the paths that a command writes."""
    asked = parsed(words)
    names = WRITTEN[:1] if words[0] == "report" else WRITTEN
    paths = [str(asked[name]) for name in names if asked.get(name) is not None]
    return [str(Path(path) / RUNS_LAST) for path in paths] if words[0] == "run" else paths


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Work in a folder for a while."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _run(folder: Path, words: Sequence[str]) -> Done:
    out, err = io.StringIO(), io.StringIO()
    with inside(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(words))
    files = {n: (folder / n).read_bytes() for n in written_by(words) if (folder / n).exists()}
    return Done(code, out.getvalue() + err.getvalue(), out.getvalue(), files)


def _digests(folder: Path, words: Sequence[str]) -> Iterator[str]:
    for name in read_by(words):
        path = folder / name
        if path.is_file() and "sample_logs" not in path.parts:
            yield hashlib.sha256(path.read_bytes()).hexdigest()


def masked(line: str) -> str:
    """Return a line of output without its numbers and its spacing."""
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", line)).strip()
