"""Does a result repeat, bit by bit or within `seqid compare`'s tolerance?

`python -m tests.studies.repeat [--other NAME=PYTHON]...` takes a sample robot from its logs to
prediction and diagnosis: once as it is, and once more with threads of BLAS, with processes, with
the logs in reverse order, and by each other installation whose interpreter is named. With --write
the table goes into docs/trust.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests import ROOT
from tests.studies.tables import show, table

SAMPLES = ROOT / "sample_logs"
PAGE = "trust.md"
_OF_THE_RUN = ("created", "parameters")
HEADER = ("robot", "what differs", "files", "bit-equal", "`compare`")


@dataclass(frozen=True)
class Way:
    """How the stages are run."""

    name: str
    python: str = sys.executable
    environment: dict[str, str] = field(default_factory=dict)
    jobs: int = 1
    reverse: bool = False


WAYS = (
    Way("nothing"),
    Way("`OPENBLAS_NUM_THREADS=2`", environment={"OPENBLAS_NUM_THREADS": "2"}),
    Way("`--jobs 2`", jobs=2),
    Way("logs in reverse order", reverse=True),
)


def lines(rig: Path, out: Path, way: Way) -> Iterator[list[str]]:
    """Command lines from the logs of a rig to prediction and diagnosis."""
    robot, before = ["-r", str(rig / "robot.toml")], list[str]()
    stages = ("friction", "gravity", "imu-calib", "inertia", "predict", "diagnose")
    folders = ("friction", "gravity", "imu", "inertia", "validation", "validation")
    for stage, folder in zip(stages, folders, strict=True):
        logs = sorted(map(str, (rig / folder).glob("*.*")), reverse=way.reverse)
        if stage == "gravity" and not logs:  # it has nothing to identify there
            logs = sorted(map(str, (rig / "friction").glob("*.*")), reverse=way.reverse)
        if not logs:
            continue
        made = out / f"{stage}.json"
        jobs = [] if stage == "diagnose" else ["--jobs", str(way.jobs)]
        yield [stage, *logs, *robot, *before, *jobs, "-o", str(made)]
        before = before if stage == "predict" else ["-p", str(made)]


def made_by(way: Way, rig: Path, out: Path) -> dict[str, str]:
    """Run the stages into an empty folder; what stands in each file, apart from when."""
    out.mkdir()
    fixed = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    environment = {**os.environ, **fixed, **way.environment}
    for line in lines(rig, out, way):
        done = subprocess.run(
            [way.python, "-m", "seqid_cli", *line], env=environment, capture_output=True, text=True
        )
        if done.returncode not in (0, 1):
            raise RuntimeError(f"{' '.join(line)}: {done.stderr[-2000:]}")
    return {path.name: told(path) for path in sorted(out.iterdir())}


def told(path: Path) -> str:
    """What a file says, apart from when it and the models that it used were made."""
    document = json.loads(path.read_text("utf-8").replace(str(path.parent), ""))
    return json.dumps({key: own for key, own in document.items() if key not in _OF_THE_RUN})


def compared(way: Way, first: Path, second: Path) -> str:
    """What `seqid compare` says of two models."""
    command = [way.python, "-m", "seqid_cli", "compare", str(first), str(second)]
    code = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True
    ).returncode
    return "unchanged" if code == 0 else "changed"


def rows(rig: Path, ways: Sequence[Way], work: Path) -> Iterator[tuple[str, ...]]:
    """How a rig's files come out each way, against those of the first."""
    first = made_by(ways[0], rig, work / "first")
    for number, way in enumerate(ways):
        out = work / str(number)
        again = made_by(way, rig, out)
        equal = [name for name in first if first[name] == again[name]]
        sys.stderr.write(f"{rig.name}, {way.name}: differ {sorted(set(first) - set(equal))}\n")
        said = compared(ways[0], work / "first" / "inertia.json", out / "inertia.json")
        yield rig.name, way.name, str(len(first)), str(len(equal)), said


def main(arguments: Sequence[str]) -> int:
    """Run the ways; 1 if a model has changed."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.repeat", description=__doc__)
    parser.add_argument("--rigs", nargs="*", default=["one_joint", "two_joint"])
    parser.add_argument("--other", nargs="*", default=[], help="NAME=PYTHON of installations")
    parser.add_argument("--write", action="store_true", help="put the table into docs/trust.md")
    chosen = parser.parse_args(arguments)
    others = [Way(name, python) for name, _, python in (o.partition("=") for o in chosen.other)]
    cells: list[tuple[str, ...]] = []
    for rig in chosen.rigs:
        with tempfile.TemporaryDirectory() as work:
            cells += rows(SAMPLES / rig, (*WAYS, *others), Path(work))
    text = table(HEADER, cells)
    show(PAGE, "repeat", text, kept=chosen.write)
    return 1 if any("changed" in row for row in cells) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
