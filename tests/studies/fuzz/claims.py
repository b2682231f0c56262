"""What a result claims, held against itself and against what other commands say.

A command that answers well may still say what is not so: that a model is good that no
sample has shown, that an error is zero, that nothing is missing where the prediction
is poor.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.senseless import senseless
from tests.studies.fuzz.answers import answer

STAGES = ("friction", "gravity", "imu-calib", "inertia", "simultaneous")


def broken(line: Sequence[str], folder: Path) -> str:
    """Return a claim in what a command wrote that does not hold; empty where all do."""
    output = folder / "out.json"
    if not output.is_file():
        return ""
    try:
        document = json.loads(
            output.read_text(encoding="utf-8"), parse_constant=_refuse
        )
    except ValueError as error:
        return f"its result is no JSON: {error}"
    checks: list[Callable[[], Iterator[str]]] = [
        lambda: senseless(document),
        lambda: groundless(document),
        lambda: _against_inspect(line, document, folder),
        lambda: _against_predict(line, document, folder),
    ]
    found = (claim for check in checks for claim in check())
    return next(found, "")


def groundless(document: Any) -> Iterator[str]:
    """Yield verdicts above poor that no sample stands behind."""
    schema = document.get("schema", "")
    if schema.startswith("seqid/params"):
        samples: dict[str, int] = {}
        for log in document["inputs"]:
            stage = log.get("stage", "")
            samples[stage] = samples.get(stage, 0) + log["samples"]
        for name, stage in document["stages"].items():
            verdicts = stage.get("verdicts", []) if isinstance(stage, dict) else []
            is_good = any(verdict["good"] for verdict in verdicts)
            if is_good and not any(samples.values()):
                yield f"{name} is good without a sample"
    if schema.startswith("seqid/prediction"):
        errors = document["joints"]
        for verdict in document["verdicts"]:
            joint = errors.get(verdict["joint"])
            if verdict["good"] and joint is not None and not joint["samples"]:
                yield f"{verdict['joint']} is good without a sample"


def _against_inspect(line: Sequence[str], document: Any, folder: Path) -> Iterator[str]:
    """Yield a stage that is good by logs in which `inspect` finds an error."""
    command = line[0]
    own = {"imu-calib": "imu", "simultaneous": "inertia"}.get(command, command)
    if command not in STAGES or "-r" not in line:
        return
    verdicts = (document["stages"].get(own) or {}).get("verdicts", [])
    if not verdicts or not all(verdict["good"] for verdict in verdicts):
        return
    robot = line[line.index("-r") + 1]
    seen = folder / "out.seen.json"
    answer(["inspect", line[1], "-r", robot, "-o", str(seen)])
    if not seen.is_file():
        yield f"{command} is good, and inspect refuses the log"
        return
    for finding in json.loads(seen.read_text())["findings"]:
        if finding["severity"] == "error" and not _is_of_imu(finding, document):
            yield f"{command} is good, and inspect says {finding['code']}"


def _is_of_imu(finding: Any, document: Any) -> bool:
    """Return whether a finding is of an IMU: not every stage uses one."""
    return finding["joint"] not in ("", *document["robot"]["joints"])


def _against_predict(line: Sequence[str], document: Any, folder: Path) -> Iterator[str]:
    """Yield that nothing is missing from a model whose prediction is poor."""
    if line[0] != "diagnose" or document["verdict"] != "nothing_missing":
        return
    predicted = folder / "out.seen.json"
    other = ["predict", *line[1:]]
    other[other.index("-o") + 1] = str(predicted)
    answer(other)
    if not predicted.is_file():
        return
    for verdict in json.loads(predicted.read_text())["verdicts"]:
        if verdict["level"] == "poor":
            yield f"nothing is missing, and {verdict['joint']} is predicted poorly"


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number")
