"""Recorded robots: the classical fit on one part of the logs, its prediction of the rest."""

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.plants.robots.identified import HeldOut, held_out, simultaneous
from tests.studies.tables import number, table

DATA = ROOT / ".." / "shared" / "data"


@dataclass(frozen=True)
class Case:
    """One robot: its folder, what to fit, what to predict, and the published fit's RMSE (N m)."""

    name: str
    folder: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    baseline: tuple[float, ...]
    baseline_cutoff_hz: float


UR10E = "identification__ur-20_02_{}.parquet"
CASES = (
    Case(
        "Staubli TX40",
        "staubli_tx40",
        ("train.parquet",),
        ("holdout.parquet",),
        (1.88, 4.28, 1.07, 0.62, 5.27, 2.20),
        40.0,
    ),
    Case(
        "UR10e",
        "ur10e_innopolis",
        tuple(map(UR10E.format, ("12-50sec_12harm", "12-40sec_12harm", "10-30sec_12harm"))),
        (UR10E.format("19_15harm50sec"),),
        (2.58, 3.77, 1.18, 0.39, 0.81, 0.63),
        5.0,
    ),
)


def missing(case: Case, folder: Path) -> str:
    there = all((folder / name).is_file() for name in (*case.train, *case.held_out))
    return "" if there else f"{case.name}: left out, its logs are not beside the project."


def predicted(case: Case, folder: Path, cutoff_hz: float | None = None) -> HeldOut:
    """Fit the training logs, predict the held-out ones; the cut-off is chosen if not given."""
    motion = MotionOptions(cutoff_hz=cutoff_hz)
    robot = load_robot(folder / "robot.toml")
    train = [read_recording(folder / name, robot) for name in case.train]
    stages = simultaneous(train, robot, motion=motion)
    rest = [read_recording(folder / name, robot) for name in case.held_out]
    return held_out(rest, robot, stages, InertiaOptions(motion=motion))


def study(chosen: Namespace | None = None, data: Path = DATA) -> str:
    del chosen  # it is quick anyway
    return "\n\n".join(_part(case, data / case.folder) for case in CASES)


def _part(case: Case, folder: Path) -> str:
    if said := missing(case, folder):
        return said
    same = predicted(case, folder, case.baseline_cutoff_hz)
    found = predicted(case, folder)
    theirs = f"{case.baseline_cutoff_hz:g} Hz"
    rows = [
        [f"fit to compare with, {theirs}", *(number(x, 3) for x in case.baseline)],
        ["all samples", *(number(float(x), 3) for x in found.every)],
        [f"all samples, {theirs}", *(number(float(x), 3) for x in same.every)],
        ["sliding samples", *(number(float(x), 3) for x in found.sliding)],
        ["share sliding, %", *(f"{100 * float(x):.0f}" for x in found.sliding_share)],
    ]
    cutoffs = ", ".join(f"{hz:.1f}" for hz in found.cutoff_hz)
    header = [
        f"{case.name}, held-out RMSE, N m",
        *(f"joint {k + 1}" for k in range(len(rows[0]) - 1)),
    ]
    note = f"{case.name}: cut-off chosen for the held-out log {cutoffs} Hz."
    return f"{table(header, rows)}\n\n{note}"
