"""A sample log with a fault planted into it, and its robot file; what is shared is made once."""

import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from seqid_cli.inspect.inspection import inspect_logs
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.unit.inspect.faults import (
    SAMPLES,
    SINGLE,
    Fault,
    read_columns,
    triad_toml,
    with_extras,
    with_triad,
    write_columns,
)
from tests.unit.inspect.planting import Columns

SEED = 5


def inspect_planted(faults: Sequence[Fault], folder: Path) -> InspectionFile:
    """Plant faults into a copy of the log that they share, and inspect that."""
    first = faults[0]
    (base,) = {_base(fault) for fault in faults}
    text = robot_text(first.rig, imus=first.of_imus, triad=first.triad)
    columns = {name: values.copy() for name, values in sound_columns(*base).items()}
    for fault in faults:
        for old, new in (fault.robot or {}).items():
            assert old in text
            text = text.replace(old, new)
        fault.plant(columns, np.random.default_rng(SEED))
    write_columns(folder / "log.parquet", columns)
    return inspect_logs([folder / "log.parquet"], robot_of(first.rig, text))


def _base(fault: Fault) -> tuple[str, str, bool, bool]:
    return fault.rig, fault.base, fault.of_imus, fault.triad


@cache
def sound_columns(rig: str, base: str, imus: bool, triad: bool) -> Columns:
    """Columns of a sample log as the faults find them."""
    columns = read_columns(SAMPLES / rig / f"{base}.parquet")
    if not imus and rig == "six_joint":
        columns = {name: values for name, values in columns.items() if "imu" not in name}
    if rig == "six_joint" and base != SINGLE:
        columns = with_extras(columns)
    if base == SINGLE:  # a third of the speeds is enough
        columns = {name: values[: len(values) // 3] for name, values in columns.items()}
    if triad:
        robot = robot_of(rig, robot_text(rig, imus=imus, triad=triad))
        columns = with_triad(columns, robot, np.random.default_rng(SEED))
    return columns


def robot_text(rig: str, *, imus: bool, triad: bool) -> str:
    """Text of the robot file that goes with the columns."""
    text = (SAMPLES / rig / "robot.toml").read_text()
    if not imus and rig == "six_joint":
        text = text[: text.index("[[imu]]")] + text[text.index("[channels]") :]
    return triad_toml(text) if triad else text


@cache
def robot_of(rig: str, text: str) -> Robot:
    """Load a robot file of this text beside the rig's URDF."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for urdf in (SAMPLES / rig).glob("*.urdf"):
            shutil.copy(urdf, folder)
        (folder / "robot.toml").write_text(text)
        return load_robot(folder / "robot.toml")
