"""Logs as strangers have them: `python -m tests.plants.strangers OUTDIR`.

The sample logs of the six-joint arm, written as other loggers would: `ur/` (RTDE, CSV),
`ros/` (ROS 2 bags, MCAP), `lerobot/` (a data set in degrees at 50 Hz), `german/` (CSV
of a spreadsheet, degrees). Each has `train` and `test`.
"""

import json
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from seqid_cli.logs.read import read_recording
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.unit.logs.format_writers import Data, csv_rtde, lerobot_table, rosbag2_mcap

SIX = ROOT / "sample_logs" / "six_joint"
SETS = {"train": "inertia", "test": "validation"}


def data_of(path: Path, every: int = 2) -> Data:
    """Read a sample log, one row of `every`."""
    robot = load_robot(SIX / "robot.toml")
    log = read_recording(path, robot)
    ampere = np.array([joint.torque_per_ampere for joint in robot.joints], dtype=float)
    rows, dq = slice(None, None, every), np.gradient(log.q, log.t, axis=0)
    q, tau = log.q[rows], log.tau[rows]
    return Data(log.t[rows], robot.joint_names, q, dq[rows], tau / ampere, tau)


def german(path: Path, data: Data) -> None:
    """Semicolons, decimal commas, degrees, in Latin-1."""
    count = len(data.joints)
    names = ["Zeit [s]", *(f"Position Achse {k + 1} [\u00b0]" for k in range(count))]
    names += [f"Strom Achse {k + 1} [A]" for k in range(count)]
    table = np.column_stack([data.t, np.rad2deg(data.q), data.current])
    lines = [
        ";".join(f"{value:.9g}" for value in row).replace(".", ",") for row in table
    ]
    text = "\n".join([";".join(names), *lines, ""])
    path.with_suffix(".csv").write_text(text, encoding="latin-1")


def lerobot(folder: Path, episodes: Sequence[Data]) -> None:
    """A data set: one episode for each log, degrees, names of the motors in
    meta/info.json.
    """
    turned = [
        Data(d.t, d.joints, np.rad2deg(d.q), d.dq, d.torque, d.torque) for d in episodes
    ]
    (folder / "data" / "chunk-000").mkdir(parents=True)
    pq.write_table(
        lerobot_table(turned), folder / "data" / "chunk-000" / "file-000.parquet"
    )
    (folder / "meta").mkdir()
    names = [f"{joint}.pos" for joint in episodes[0].joints]
    info = {
        "fps": 50,
        "features": {"observation.state": {"dtype": "float32", "names": names}},
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))


WRITERS: dict[str, Callable[[Path, Data], object]] = {
    "ur": csv_rtde,
    "ros": lambda path, data: rosbag2_mcap(path, replace(data, current=data.torque)),
    "german": german,
}


def make(folder: Path) -> None:
    shutil.copy(SIX / "six_joint.urdf", folder / "arm.urdf")
    for part, stage in SETS.items():
        logs = sorted((SIX / stage).iterdir())
        lerobot(folder / "lerobot" / part, [data_of(log, every=5) for log in logs])
        for name, write in WRITERS.items():
            (folder / name / part).mkdir(parents=True)
            for log in logs:
                write(folder / name / part / log.stem, data_of(log))


if __name__ == "__main__":
    make(Path(sys.argv[1]))
