"""What diagnosing and refining cost: two and six joints, minutes of logs, two IMUs."""

import json
import os
import sys
from argparse import Namespace
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests import ROOT
from tests.benchmarks.measure import child_cost, child_cpu_s
from tests.plants.effects.registry import inject
from tests.plants.motions.experiments import Trial
from tests.plants.motions.trajectories import Reference
from tests.plants.motions.trials import PERIODS, moves, waves, zigzags
from tests.plants.samples import RECIPES, save
from tests.plants.simulate import simulate
from tests.studies.tables import table

SECONDS, EVERY, PAUSE_S = 20.0, 2, 60.0
SPEEDS = (0.9, 0.6, 0.8, 0.4)  # of the top speeds, log by log
HELD_OUT = 2  # logs
SHORT_S, SHORT_PERIOD_S, SHORT_LOGS, LONG_S = 4.0, 2.0, 25, 100.0
SHORT_PAUSE_S = 30.0


@dataclass(frozen=True)
class Subject:
    """A sample robot, the effect that it has then, and the number of logs of 20 s."""

    rig: str
    effect: str
    joint: int
    logs: int


SUBJECTS = (
    Subject("two_joint", "load_dependent_friction", 1, 8),
    Subject("six_joint", "gear_efficiency", 2, 6),
)


def study(chosen: Namespace) -> str:
    rows = [_row(subject) for subject in SUBJECTS[: 1 if chosen.quick else None]]
    head = [
        "robot",
        "samples",
        "found",
        "diagnose, CPU s",
        "refine, CPU s",
        "refine over diagnose",
    ]
    return table(head, rows)


def _row(subject: Subject) -> list[str]:
    sample = ROOT / "sample_logs" / subject.rig
    robot = ["-r", str(sample / "robot.toml")]
    with TemporaryDirectory() as folder:
        logs, samples = recorded(subject, Path(folder))
        _run("run", str(sample), *robot, "-o", f"{folder}/model")
        model = [*robot, "-p", f"{folder}/model/inertia.json"]
        fit, held = logs[:-HELD_OUT], logs[-HELD_OUT:]
        diagnosis = _run("diagnose", *fit, *model, "-o", f"{folder}/diagnosis.json")
        told = json.loads(Path(folder, "diagnosis.json").read_bytes())["findings"]
        kept = [part for log in held for part in ("--holdout", log)]
        refined = _run("refine", *fit, *kept, *model, "-o", f"{folder}/refined.json")
    found = ", ".join(f"{one['effect']} at {one['joint']}" for one in told) or "-"
    costs = [f"{diagnosis:.1f}", f"{refined:.1f}", f"{refined / diagnosis:.1f}"]
    return [subject.rig, f"{samples:,}", found, *costs]


def recorded(subject: Subject, folder: Path) -> tuple[list[str], int]:
    """Record the logs, those that are held out last; also the samples of the others."""
    recipe, rng = RECIPES[subject.rig](), np.random.default_rng(99)
    plant = inject(subject.effect, recipe.plant, subject.joint).plant
    one, two = (partial(waves, period=period) for period in PERIODS[:2])
    samples = 0
    for number in range(subject.logs + HELD_OUT):
        make, share = (one, moves, two, zigzags)[number % 4], SPEEDS[number % 4]
        motion = make(plant, rng, share=share, seconds=SECONDS)
        start = PAUSE_S + number * (SECONDS + PAUSE_S)
        log = simulate(
            plant, motion, 5000 + number, every=EVERY, imus=True, start=start
        )
        save(folder, recipe, Trial("logs", f"log_{number}", motion, imus=True), log)
        samples += len(log.t) if number < subject.logs else 0
    names = [f"log_{number}.parquet" for number in range(subject.logs + HELD_OUT)]
    return [str(folder / "logs" / name) for name in names], samples


def short_logs(chosen: Namespace) -> str:
    """Refine the six-joint arm from many short logs, and from one of their length."""
    sample = ROOT / "sample_logs" / "six_joint"
    robot = ["-r", str(sample / "robot.toml")]
    rows = []
    with TemporaryDirectory() as folder:
        _record_short(Path(folder))
        _run("run", str(sample), *robot, "-o", f"{folder}/model", "--no-refine")
        model = [*robot, "-p", f"{folder}/model/inertia.json"]
        held = ["--holdout", f"{folder}/held"]
        for part, logs in {"short": SHORT_LOGS, "long": 1}.items():
            output = f"{folder}/{part}.json"
            given = ["refine", f"{folder}/{part}", *held, *model, "-o", output]
            cost = child_cost(_command(*given), ENVIRONMENT)
            rounds = json.loads(Path(output).read_bytes())["closed_loop"]["rounds"]
            added = ", ".join(f"{one['effect']} at {one['joint']}" for one in rounds)
            size = SHORT_S if part == "short" else LONG_S
            text = f"{logs} of {size:g} s"
            rows.append([text, added, f"{cost.cpu_s:.0f}", f"{cost.peak_mib:.0f}"])
    return table(["logs", "added", "refine, CPU s", "peak MiB"], rows)


def _record_short(folder: Path) -> None:
    """Record short logs, two that are held out, and one as long as all the others."""
    recipe, rng = RECIPES["six_joint"](), np.random.default_rng(99)
    plant = inject("gear_efficiency", recipe.plant, 2).plant
    start = PAUSE_S

    def record(part: str, name: str, motion: Reference, seed: int) -> None:
        nonlocal start
        log = simulate(plant, motion, seed, every=EVERY, imus=False, start=start)
        save(folder, recipe, Trial(part, name, motion, imus=False), log)
        start += motion.duration + SHORT_PAUSE_S

    for number in range(SHORT_LOGS + HELD_OUT):
        motion = waves(
            plant,
            rng,
            period=SHORT_PERIOD_S,
            share=SPEEDS[number % 4],
            seconds=SHORT_S,
        )
        part = "short" if number < SHORT_LOGS else "held"
        record(part, f"log_{number:02d}", motion, 5000 + number)
    record("long", "long", moves(plant, rng, share=0.8, seconds=LONG_S), 6000)


ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def _run(*arguments: str) -> float:
    return child_cpu_s(_command(*arguments), ENVIRONMENT)


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "seqid_cli", *arguments]
