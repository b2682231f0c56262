"""A folder with one sample log and its robot file, to plant a fault into."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from seqid_cli.inspect.inspect import inspect_logs
from seqid_cli.inspect.report import InspectReport
from seqid_cli.robot.file import load_robot
from tests.inspect.faults import (
    SAMPLES,
    SINGLE,
    Fault,
    read_columns,
    triad_toml,
    with_extras,
    with_triad,
    write_columns,
)


def inspect_planted(fault: Fault, folder: Path, *, planted: bool = True) -> InspectReport:
    """Plant a fault into a copy of its log, or not, and inspect that."""
    for urdf in (SAMPLES / fault.rig).glob("*.urdf"):
        shutil.copy(urdf, folder)
    text = (SAMPLES / fault.rig / "robot.toml").read_text()
    for old, new in (fault.robot or {}).items() if planted else ():
        assert old in text
        text = text.replace(old, new)
    columns = read_columns(SAMPLES / fault.rig / f"{fault.base}.parquet")
    rng = np.random.default_rng(5)
    if not fault.of_imus and fault.rig == "six_joint":
        start, end = text.index("[[imu]]"), text.index("[channels]")
        text = text[:start] + text[end:]
        columns = {name: values for name, values in columns.items() if "imu" not in name}
    (folder / "robot.toml").write_text(triad_toml(text) if fault.triad else text)
    robot = load_robot(folder / "robot.toml")
    if fault.rig == "six_joint" and fault.base != SINGLE:
        columns = with_extras(columns)
    if fault.triad:
        columns = with_triad(columns, robot, rng)
    if planted:
        fault.plant(columns, rng)
    write_columns(folder / "log.parquet", columns)
    return inspect_logs([folder / "log.parquet"], robot)
