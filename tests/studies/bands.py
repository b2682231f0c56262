"""Do bands of predicted torques hold on logs that were not fitted?

Drawn arms, recorded robots.
"""

import warnings
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from seqid_cli import identify
from seqid_cli.errors import SeqidWarning
from seqid_cli.params.results.prediction import BandCoverage, PredictionFile
from tests import ROOT
from tests.plants.motions.experiments import validation_trials
from tests.plants.robots.lab import write_log
from tests.plants.simulate import simulate
from tests.studies.coverage.cases import STREAM, case_of, draw, record
from tests.studies.coverage.score import identified
from tests.studies.coverage.study import NAMES, kind_of
from tests.studies.records import seeds_of
from tests.studies.tables import table

DATA = ROOT / ".." / "shared" / "data"
SEEDS = {"one": "0:8", "planar": "0:8", "six": "0:1"}  # of the document
QUICK = "0:2"
VALIDATION_STREAM = 96
UR10E = "ur10e_innopolis/identification__ur-20_02_"


@dataclass(frozen=True)
class Recorded:
    """A recorded robot: its file, the logs that are fitted and those that are
    predicted.
    """

    name: str
    robot: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]

    def paths(self, names: Sequence[str]) -> list[str]:
        """Return the logs of some names, which may be folders;
        none if any is missing.
        """
        paths = [DATA / name for name in names]
        return (
            [str(path) for path in paths]
            if all(path.exists() for path in paths)
            else []
        )


def _ur10e(*names: str) -> tuple[str, ...]:
    return tuple(f"{UR10E}{name}.parquet" for name in names)


TRAIN = _ur10e("12-50sec_12harm", "12-40sec_12harm", "10-30sec_12harm")
OTHER_DAYS = ("05-20sec_12harm", "05-20sec_8harm", "06-20sec_10harm", "06-20sec_5harm")
RECORDED = (
    Recorded(
        "Staubli TX40",
        "staubli_tx40/robot.toml",
        ("staubli_tx40/train.parquet",),
        ("staubli_tx40/holdout.parquet",),
    ),
    Recorded("UR10e", "ur10e_innopolis/robot.toml", TRAIN, _ur10e("19_15harm50sec")),
    Recorded(
        "UR10e, other days",
        "ur10e_innopolis/robot.toml",
        TRAIN,
        _ur10e(*OTHER_DAYS, "10-20sec_7harm", "19_14harm50sec"),
    ),
    Recorded(
        "Rokae xMate 3 Pro",
        "rokae_xmate/robot.toml",
        ("rokae_xmate/train.parquet",),
        ("rokae_xmate/holdout.parquet",),
    ),
    Recorded(
        "UR5e, joint 0",
        "ur5e_joints/joint_0_robot.toml",
        ("ur5e_joints/joint_0_train.parquet",),
        ("ur5e_joints/joint_0_holdout.parquet",),
    ),
    Recorded(
        "UR5e, joint 5",
        "ur5e_joints/joint_5_robot.toml",
        ("ur5e_joints/joint_5_train.parquet",),
        ("ur5e_joints/joint_5_holdout.parquet",),
    ),
    Recorded(
        "SO-101", "so101_sage/robot.toml", ("so101_sage/train",), ("so101_sage/held",)
    ),
    Recorded(
        "UR5 (CB2)", "ur5_xsens/robot.toml", ("ur5_xsens/train",), ("ur5_xsens/held",)
    ),
)
HEADER = (
    "",
    "joints",
    "blocks",
    "in 90 %",
    "slow",
    "fast",
    "low load",
    "high load",
    "in 95 %",
)
GROUPS = ("slow", "fast", "low_load", "high_load")


def study(chosen: Namespace) -> str:
    """Return a table of drawn arms, and one of recorded robots with a row of shares per
    joint.
    """
    rows = []
    for rig in ("one",) if chosen.quick else NAMES:
        seeds = seeds_of(chosen.seeds or (QUICK if chosen.quick else SEEDS[rig]))
        found = [_drawn(rig, seed) for seed in seeds]
        told = f"{NAMES[rig]}, {len(seeds)} {kind_of(seeds)} seeds"
        rows.append(_row(told, found))

    by_joint = []
    for case in RECORDED:
        train, held_out = case.paths(case.train), case.paths(case.held_out)
        if chosen.quick or not train or not held_out:
            continue
        prediction = _recorded(str(DATA / case.robot), train, held_out)
        rows.append(_row(case.name, [prediction]))
        by_joint.append([case.name, *_shares_by_joint(prediction)])
    parts = [table(HEADER, rows)]
    if by_joint:
        joints = [f"joint {k + 1}" for k in range(max(map(len, by_joint)) - 1)]
        wide = [[*row, *["-"] * (len(joints) + 1 - len(row))] for row in by_joint]
        parts.append(table(["in 90 %, by joint", *joints], wide))
    return "\n\n".join(parts)


def _drawn(rig: str, seed: int) -> PredictionFile:
    """Identify one drawn arm and predict a motion of all joints that no stage
    has seen.
    """
    case = case_of(rig, seed)
    drawn = draw(case)
    with TemporaryDirectory(prefix="seqid-bands-") as name:
        folder = Path(name)
        record(case, drawn, folder)
        stages, problem = identified(folder)
        if problem or stages.inertia is None:
            raise RuntimeError(f"{case.label}: {problem}")

        rng = np.random.default_rng([STREAM[rig], seed, VALIDATION_STREAM])
        rate_hz = 500.0 if rig == "six" else 1000.0
        for number, trial in enumerate(
            validation_trials(drawn.plant, rng, rate_hz=rate_hz)
        ):
            noise = int(rng.integers(2**31)) + number
            log = simulate(
                drawn.plant, trial.reference, noise, every=drawn.every, imus=trial.imus
            )
            write_log(folder / "validation" / f"{trial.name}.parquet", drawn.plant, log)
        logs, robot, model = (
            folder / "validation",
            folder / "robot.toml",
            folder / "inertia.json",
        )
        found: PredictionFile = _quietly(
            lambda: identify.predict(str(logs), robot, model)
        )
        return found


def _recorded(
    robot: str, train: Sequence[str], held_out: Sequence[str]
) -> PredictionFile:
    """Fit the training logs in one step, predict those that are held out."""
    model = _quietly(lambda: identify.simultaneous(train, robot))
    found: PredictionFile = _quietly(lambda: identify.predict(held_out, robot, model))
    return found


def _quietly(work: Callable[[], Any]) -> Any:
    with warnings.catch_warnings(action="ignore", category=SeqidWarning):
        return work()


def _row(name: str, found: Sequence[PredictionFile]) -> list[str]:
    """Shares of samples in the bands, each the mean over joints."""
    joints = [
        x.coverage
        for file in found
        for x in file.joints.values()
        if x.coverage is not None
    ]
    overall = [x.overall for x in joints]
    blocks = int(np.median([x.blocks for x in overall]))
    sides = [_mean([getattr(x, side) for x in joints], "band_90") for side in GROUPS]
    ends = _mean(overall, "band_90"), _mean(overall, "band_95")
    return [name, str(len(joints)), str(blocks), ends[0], *sides, ends[1]]


def _mean(found: Sequence[BandCoverage | None], band: str) -> str:
    """Mean of the shares that there are, %."""
    shares = [getattr(x, band) for x in found if x is not None]
    known = [share for share in shares if share is not None]
    return f"{100.0 * float(np.mean(known)):.1f}" if known else "-"


def _shares_by_joint(file: PredictionFile) -> list[str]:
    """Shares in the 90 % band of each joint, %."""
    return [
        _mean([None if x.coverage is None else x.coverage.overall], "band_90")
        for x in file.joints.values()
    ]
