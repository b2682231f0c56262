"""Planted faults against stages: does the stage that reads a faulty log say so?

Every fault is planted into the logs (or the robot file) of arms whose sound logs are good in every
stage; each stage then runs as a user would run it. A cell says what the stage says: `poor` (a
verdict of a joint or of the stage, with the reason), `refused` (it does not run, exit code 2),
`mended` (it says so, has put it right, and the verdict is good), or `good`, which only a fault may
be that this stage cannot see for a physical reason.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli import identify
from seqid_cli.errors import SeqidError, SeqidWarning
from seqid_cli.params.schema import FrictionStage, ImuStage, RigidStage, Verdict
from tests.studies.planted.arms import ARMS, Bench
from tests.studies.records import results
from tests.unit.inspect.faults import write_columns
from tests.unit.inspect.planting import Columns

Array = NDArray[np.float64]

STAGES = ("friction", "gravity", "imu-calib", "inertia", "simultaneous", "predict")
FOLDERS = {
    "friction": ("friction",),
    "gravity": ("gravity", "friction"),  # the first that is there
    "imu-calib": ("imu",),
    "inertia": ("inertia",),
    "simultaneous": ("inertia",),
    "predict": ("validation",),
}
SEED = 11
DEGREES = 180.0 / np.pi


@dataclass(frozen=True)
class Fault:
    """A change of every log, or of one log of the stage alone (`single`), or of the robot file."""

    name: str
    plant: Callable[[Columns, Bench, np.random.Generator], None] | None = None
    robot: Callable[[str, Bench], str] | None = None
    single: bool = False
    needs: str = ""  # without which no stage can see it: "weight", "velocity"


def _sign(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    columns[f"{bench.joint}.current"] *= -1.0


def _swapped(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    if bench.other:
        for kind in ("position", "current"):
            a, b = f"{bench.joint}.{kind}", f"{bench.other}.{kind}"
            columns[a], columns[b] = columns[b], columns[a]


def _amperes(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    for name in [name for name in columns if name.endswith(".current")]:
        columns[name.removesuffix("current") + "torque"] = columns.pop(name)


def _degrees(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    columns[f"{bench.joint}.position"] *= DEGREES


def _busy(columns: Columns, bench: Bench, rng: np.random.Generator) -> tuple[str, int]:
    """A joint that moves in this log, and a sample at which it does."""
    names = [name for name in columns if name.endswith(".position")]
    name = max(names, key=lambda each: float(np.ptp(columns[each])))
    moving = np.flatnonzero(np.abs(np.gradient(columns[name], columns["t"])) > 0.05)
    margin = len(columns["t"]) // 8
    inner = moving[(moving > margin) & (moving < len(columns["t"]) - margin)]
    return name, int(rng.choice(inner))


def _spike(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    name, at = _busy(columns, bench, rng)
    columns[name][at] += 0.3


def _hole(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    name, at = _busy(columns, bench, rng)
    rate = 1.0 / float(np.median(np.diff(columns["t"])))
    columns[name][at : at + int(0.15 * rate)] = np.nan


def _lost(columns: Columns, bench: Bench, rng: np.random.Generator) -> None:
    """Rows are lost every second, and what is left is stamped evenly, as by a counter.

    One of the losses is where a joint moves: at rest nothing is lost.
    """
    t, at = columns["t"], _busy(columns, bench, rng)[1]
    step = float(np.median(np.diff(t)))
    velocity = {
        name.removesuffix("position") + "velocity": np.gradient(columns[name], t)
        for name in columns
        if name.endswith(".position")
    }
    columns.update({name: np.convolve(v, np.ones(5) / 5, "same") for name, v in velocity.items()})
    every, lost = max(int(1.0 / step), 40), max(int(0.03 / step), 2)
    kept = (np.arange(len(t)) - at + lost // 2) % every >= lost
    for name in columns:
        columns[name] = columns[name][kept]
    columns["t"] = t[0] + step * np.arange(int(kept.sum()))


def _scaled_key(key: str, factor: float, text: str, bench: Bench) -> str:
    lines = []
    for line in text.splitlines():
        name, _, value = line.partition(" = ")
        lines.append(f"{key} = {float(value) * factor!r}" if name == key else line)
    return "\n".join(lines) + "\n"


def _gravity(text: str, bench: Bench) -> str:
    turned = f"gravity = [{bench.other_gravity}]"
    return (
        "\n".join(turned if line.startswith("gravity = ") else line for line in text.splitlines())
        + "\n"
    )


FAULTS = (
    Fault("none"),
    Fault("wrong sign of a current", _sign),
    Fault("two joints swapped", _swapped),
    Fault("amperes as torque", _amperes),
    Fault("degrees", _degrees),
    Fault("one spike", _spike, single=True),
    Fault("a hole of NaN", _hole, single=True),
    Fault("lost samples", _lost, single=True),
    Fault("gear ratio a third", robot=partial(_scaled_key, "gear_ratio", 1 / 3), needs="weight"),
    Fault("wrong direction of gravity", robot=_gravity, needs="gravity"),
    Fault(
        "torque constant by ten",
        robot=partial(_scaled_key, "torque_constant", 10.0),
        needs="weight",
    ),
)


@dataclass
class Cell:
    """What a stage said: refused, poor or good, and why; `notes` are what it put right."""

    answer: str
    reasons: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


Told = tuple[Sequence[Verdict], Sequence[str]]


def _answer(run: Callable[[], Told]) -> Cell:
    try:
        verdicts, notes = run()
    except SeqidError as error:
        return Cell("refused", [str(error)])
    poor = [f"{v.joint}: {v.reason}" for v in verdicts if not v.good]
    about_logs = [note for note in notes if re.search(r"\[[a-z_]+\] ", note)]
    return Cell("poor" if poor else "good", poor, about_logs)


def stage_verdicts(
    stage: str, logs: Sequence[Path], robot: Path, before: Path | None, out: Path
) -> Told:
    """Run a stage on logs; returns its verdicts and notes."""
    paths = list(logs)
    if stage == "predict":
        assert before is not None
        said = identify.predict(paths, robot, before)
        return said.verdicts, said.notes
    if stage == "friction":
        return _told(identify.friction(paths, robot, ORDERS, output=out).stages.friction)
    if stage == "simultaneous":
        found = identify.simultaneous(paths, robot, output=out).stages
        parts = _told(found.friction), _told(found.inertia)
        return [*parts[0][0], *parts[1][0]], [*parts[0][1], *parts[1][1]]
    assert before is not None
    if stage == "gravity":
        return _told(identify.gravity(paths, robot, before, output=out).stages.gravity)
    if stage == "imu-calib":
        return _told(identify.imu_calib(paths, robot, parameters=before, output=out).stages.imu)
    return _told(identify.inertia(paths, robot, before, output=out).stages.inertia)


def _told(stage: FrictionStage | RigidStage | ImuStage | None) -> Told:
    assert stage is not None
    return stage.verdicts, stage.notes


ORDERS = identify.FrictionOptions(position_order=4, velocity_order=4)  # of all, for speed
BEFORE = {"gravity": "friction", "imu-calib": "gravity", "inertia": "gravity", "predict": "inertia"}


def answers(
    bench: Bench, fault: Fault, clean: Path, folder: Path, stages: Sequence[str] = STAGES
) -> dict[str, Cell]:
    """Run stages of a bench with a fault.

    Earlier stages are those of the faulty logs where the fault is in all of them, as on a real
    robot; where such a stage refuses, or the fault is in one log alone, those of the sound ones.
    """
    robot, found = folder / "robot.toml", {}
    for path in bench.folder.glob("*.urdf"):
        shutil.copy(path, folder)
    text = bench.toml
    robot.write_text(fault.robot(text, bench) if fault.robot else text)
    for stage in stages:
        logs = _logs(bench, stage)
        if not logs:
            continue
        own = list(_planted(bench, fault, logs, folder / stage))
        before = folder / f"{BEFORE.get(stage, '-')}.json"
        if fault.single or not before.exists():
            before = clean / before.name
        out = folder / f"{stage}.json"
        found[stage] = _answer(partial(stage_verdicts, stage, own, robot, before, out))
    return found


def _logs(bench: Bench, stage: str) -> list[Path]:
    for name in FOLDERS[stage]:
        logs = sorted((bench.folder / name).glob("*"))
        if logs:
            return logs
    return []


def _planted(bench: Bench, fault: Fault, logs: Sequence[Path], folder: Path) -> Iterator[Path]:
    """Write the logs of a stage with the fault in all of them, or in the one in the middle."""
    folder.mkdir()
    for number, path in enumerate(logs):
        hit = fault.plant is not None and (not fault.single or number == len(logs) // 2)
        if not hit or fault.plant is None:
            yield path
            continue
        columns = bench.columns(path)
        fault.plant(columns, bench, np.random.default_rng(SEED))
        yield folder / f"{path.stem}.parquet"
        write_columns(folder / f"{path.stem}.parquet", columns)


def bench_answers(
    bench: Bench, faults: Sequence[Fault] = FAULTS, kept: Path | None = None
) -> dict[str, dict[str, Cell]]:
    """Answers by fault and stage, the sound logs first; `kept` is a file that they are kept in."""
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        clean = Path(name) / "clean"

        def one(fault: Fault) -> dict[str, Cell]:
            if not clean.exists():  # the stages of the sound logs, which other faults start from
                clean.mkdir()
                sound = answers(bench, faults[0], clean, clean)
                if fault is faults[0]:
                    return sound
            folder = Path(name) / fault.name.replace(" ", "_")
            folder.mkdir()
            return answers(bench, fault, clean, folder)

        by_name = {fault.name: fault for fault in faults}
        return results(by_name, one, dict[str, Cell], kept)


TORQUE_ALONE = ("wrong sign of a current", "amperes as torque")


def excused(fault: Fault, stage: str, bench: Bench) -> str:
    """Why a stage cannot see a fault on this arm; empty where it must."""
    swapped = fault.name == "two joints swapped"
    if swapped and not bench.other:
        return "one joint"
    if stage == "gravity" and not bench.loaded:
        return "nothing to identify"
    if stage == "imu-calib" and (fault.needs == "weight" or fault.name in TORQUE_ALONE):
        return "torque is not used"
    if fault.needs and not bench.weighed:
        return "no masses"
    if swapped and not bench.weighed and stage in ("friction", "imu-calib"):
        return "no masses"
    return ""


def study(chosen: argparse.Namespace) -> str:
    """Table over faults, stages and arms; what is known already is kept in the cache."""
    benches = [make() for make in (ARMS[:1] if chosen.quick else ARMS)]
    folder = None if chosen.quick else chosen.cache / "planted"
    files = [folder / f"{bench.name}.jsonl" if folder else None for bench in benches]
    told = [bench_answers(b, kept=file) for b, file in zip(benches, files, strict=True)]
    return tabulated(benches, told)


def tabulated(benches: Sequence[Bench], told: Sequence[Mapping[str, Mapping[str, Cell]]]) -> str:
    """Markdown: per cell how many arms said so, of how many."""
    lines = ["| fault | " + " | ".join(STAGES) + " |", "|---" * (len(STAGES) + 1) + "|"]
    for fault in FAULTS:
        row = [fault.name]
        for stage in STAGES:
            row.append(_cell(fault, stage, benches, told))
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def _cell(
    fault: Fault,
    stage: str,
    benches: Sequence[Bench],
    told: Sequence[Mapping[str, Mapping[str, Cell]]],
) -> str:
    counts: dict[str, int] = {}
    for bench, answered in zip(benches, told, strict=True):
        cell = answered.get(fault.name, {}).get(stage)
        if cell is None:
            continue
        answer = cell.answer
        if fault.name != "none" and answer != "refused":
            sound = answered["none"].get(stage)
            answer = "mended" if cell.notes and not (sound and sound.notes) else "good"
            answer = "poor" if new_reasons(cell, sound) else answer
            why = excused(fault, stage, bench)
            answer = f"not seen ({why})" if answer == "good" and why else answer
        counts[answer] = counts.get(answer, 0) + 1
    return ", ".join(f"{answer} {count}" for answer, count in sorted(counts.items())) or "-"


def new_reasons(cell: Cell, sound: Cell | None) -> list[str]:
    """Reasons that the sound logs do not give as well, whatever the numbers in them."""
    known = {_words(reason) for reason in sound.reasons} if sound else set()
    return [reason for reason in cell.reasons if _words(reason) not in known]


def _words(reason: str) -> str:
    return re.sub(r"[-+0-9.e]+", "", reason)
