"""Identification from logs whose samples were lost without the stamps showing it."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.file import load_robot

INERTIA, COULOMB, VISCOUS = 0.4, 2.0, 1.5
ROBOT = """schema = "seqid/robot@1"
name = "one"
gravity = [0.0, 0.0, -9.81]
[[joint]]
name = "base"
dh = { alpha = 0.0, a = 0.0, d = 0.1, theta0 = 0.0 }
"""


def write_log(path: Path, rate_hz: float, lost: int, seed: int) -> Path:
    """A joint about a vertical axis; every 60 ms worth of rows some are lost, not so the stamps."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 1.0 / rate_hz)
    w, size = np.array([0.9, 2.3, 4.1]), np.array([0.8, 0.5, 0.25])
    phase = rng.uniform(0.0, 6.0, 3)
    angle = w * t[:, None] + phase
    q, dq = np.sin(angle) @ size, np.cos(angle) @ (size * w)
    ddq = -np.sin(angle) @ (size * w**2)
    tau = INERTIA * ddq + COULOMB * np.tanh(dq / 0.01) + VISCOUS * dq
    tau += rng.normal(0.0, 0.1, len(t))
    q = 2e-5 * np.round(q / 2e-5)
    every = round(0.12 * rate_hz)
    kept = np.arange(len(t)) % every >= lost
    columns = {"base.position": q, "base.velocity": dq, "base.torque": tau}
    rows = {name: values[kept] for name, values in columns.items()}
    pq.write_table(pa.table({"t": t[: kept.sum()], **rows}), path)
    return path


@pytest.mark.parametrize("rate_hz", [250.0, 500.0, 1000.0])
def test_the_inertia_is_that_of_the_whole_log(tmp_path: Path, rate_hz: float) -> None:
    (tmp_path / "robot.toml").write_text(ROBOT)
    robot = load_robot(tmp_path / "robot.toml")
    found = []
    for lost in (0, round(0.03 * rate_hz)):
        log = write_log(tmp_path / f"{lost}.parquet", rate_hz, lost, seed=4)
        logs = [read_recording(log, robot)]
        _, inertia = identify_simultaneous(logs, robot, options=MotionOptions())
        found.append(inertia)
    whole, lossy = (stage.parameters[-1] for stage in found)
    assert whole.value == pytest.approx(INERTIA, rel=0.02)
    # A quarter of the time is gone: on the stamps as logged the inertia comes out 40 % too small.
    assert lossy.value == pytest.approx(INERTIA, rel=0.05)
    assert not found[0].motion_use[0].warnings
    assert "samples are lost" in found[1].motion_use[0].warnings[0]
