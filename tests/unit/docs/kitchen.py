"""Runs the commands of the documents, each once, and keeps what they need at hand.

A page has a folder of its own with `sample_logs` in it. What a command reads and no
command of the page has made comes from the golden files, for `six_joint` from the
classical fit, which is quick.
"""

import contextlib
import hashlib
import io
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
MADE = {
    "prediction.json": PREDICT,
    "torques.parquet": PREDICT,
    "diagnosis.json": (
        "diagnose {r}/validation -r {r}/robot.toml -p inertia.json -o diagnosis.json"
    ),
    # stands for the plan of a whole session
    "plan.json": "plan friction -r {r}/robot.toml -o plan.json",
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
    done: dict[tuple[str, ...], Done] = field(default_factory=dict)

    def page_folder(self, name: str) -> Path:
        path = self.folder / name
        if not path.exists():
            path.mkdir()
            (path / "sample_logs").symlink_to(SAMPLES)
        return path

    def cook(self, folder: Path, words: Sequence[str]) -> Done:
        """Run `seqid` with these words in a folder, or bring what it wrote the last
        time.
        """
        read = [
            folder / name
            for name in read_by(words)
            if "sample_logs" not in Path(name).parts
        ]
        key = (
            *words,
            *(hashlib.sha256(p.read_bytes()).hexdigest() for p in read if p.is_file()),
        )
        if key not in self.done:
            self.done[key] = _run(folder, words)
        done = self.done[key]
        for name, content in done.files.items():
            (folder / name).write_bytes(content)
        return done

    def fetch(self, folder: Path, name: str, rig: str) -> None:
        path = Path(name)
        if path.parent.parts[:1] == ("out",):
            rig = path.parent.parts[1]
        own = self.page_folder(f"larder_{rig}")
        wanted = (
            ["inertia.json", "prediction.json"]
            if path.name == "*.json"
            else [path.name]
        )
        for item in wanted:
            self._larder(own, item, rig)
            target = folder / path.parent / item
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.exists():
                shutil.copy(own / item, target)

    def _larder(self, own: Path, name: str, rig: str) -> None:
        if (own / name).exists():
            return
        exported = name == "export.json" or name.endswith(".urdf")
        recipe = EXPORT if exported else MADE.get(name, SIMULTANEOUS)
        if recipe == SIMULTANEOUS and rig != "six_joint":
            shutil.copy(SAMPLES / rig / "golden.json", own / name)
            return
        if recipe != SIMULTANEOUS:
            self._larder(own, "inertia.json", rig)
        words = recipe.format(r=f"sample_logs/{rig}", name=rig).split()
        done = self.cook(own, words)
        assert done.code == 0, done.said
        if exported:
            (own / "export.json").write_text(done.out, encoding="utf-8")
        elif not (own / name).exists():
            # a refined file is one as well
            shutil.copy(own / "inertia.json", own / name)


def rig_of(words: Sequence[str], default: str = "one_joint") -> str:
    return next((rig for rig in RIGS if any(rig in word for word in words)), default)


def is_dear(words: Sequence[str]) -> bool:
    """Return whether a command takes long: it is run by `make docs-test` alone."""
    rig, new = rig_of(words), any("validation" in word for word in words)
    return {
        "run": rig == "six_joint",
        "plan": rig == "six_joint" and "all" in words,
        **dict.fromkeys(IDENTIFY, rig != "one_joint"),
        "diagnose": rig != "one_joint" or not new,
        **dict.fromkeys(("inspect", "init"), rig == "six_joint" and not new),
        "refine": True,
    }.get(words[0], False)


def parsed(words: Sequence[str]) -> dict[str, Any]:
    if "--show-settings" in words:  # which asks for nothing else
        return {}
    with load_command(words[0]).make_context(words[0], list(words[1:])) as context:
        return dict(context.params)


def read_by(words: Sequence[str]) -> Iterator[str]:
    asked = parsed(words)
    for name in (*READ, "torques") if words[0] == "report" else READ:
        value = asked.get(name)
        for item in value if isinstance(value, list | tuple) else [value]:
            if item is not None:
                yield str(item)


def written_by(words: Sequence[str]) -> list[str]:
    asked = parsed(words)
    names = WRITTEN[:1] if words[0] == "report" else WRITTEN
    paths = [str(asked[name]) for name in names if asked.get(name) is not None]
    return [f"{path}/report.html" for path in paths] if words[0] == "run" else paths


def _run(folder: Path, words: Sequence[str]) -> Done:
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = main(list(words))
    files = {
        n: (folder / n).read_bytes() for n in written_by(words) if (folder / n).exists()
    }
    return Done(code, out.getvalue() + err.getvalue(), out.getvalue(), files)


def masked(line: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", line)).strip()
