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
from tests.benchmarks.measure import child_cpu_s
from tests.plants.effects.registry import inject
from tests.plants.motions.experiments import Trial
from tests.plants.motions.trials import PERIODS, moves, waves, zigzags
from tests.plants.samples import RECIPES, save
from tests.plants.simulate import simulate
from tests.studies.tables import table

SECONDS, EVERY, PAUSE_S = 20.0, 2, 60.0
SPEEDS = (0.9, 0.6, 0.8, 0.4)  # of the top speeds, log by log
HELD_OUT = 2  # logs


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


def _run(*arguments: str) -> float:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return child_cpu_s([sys.executable, "-m", "seqid_cli", *arguments], environment)
