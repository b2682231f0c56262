"""Faults of MCAP logs: stamps, clocks, damage, what `effort` is."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.robot.file import load_robot
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns
from tests.unit.logs.writers import Message, arm_messages, write_messages

FOLDER = SAMPLES / "six_joint"


def messages(imu_late_s: float, log_late_s: float) -> list[Message]:
    """Of joints and of imu_a; the robot file has another IMU, which a log need not have."""
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    columns = {name: values[:1000] for name, values in columns.items()}
    q, effort = (
        np.column_stack([columns[f"{name}.{kind}"] for name in SIX])
        for kind in ("position", "current")
    )
    array = {"imu_a": np.column_stack([columns[f"imu_a.a{k}"] for k in range(1, 13)])}
    joints = arm_messages(columns["t"], SIX, q, effort=effort)
    both = arm_messages(columns["t"] + imu_late_s, SIX, q, accelerometers=array)
    made = joints + [message for message in both if message[0] != "/joint_states"]
    late = round(log_late_s * 1e9)
    return sorted(((topic, at + late, x) for topic, at, x in made), key=lambda message: message[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "late", "code", "joints"),
    [
        ("none", (0.0, 0.0), "", []),
        ("stamps", (0.0, 0.0), "stamps_zero", [""]),
        ("earlier", (0.0, -0.5), "header_clock", [""]),
        ("hour", (0.0, 3600.0), "header_clock", [""]),
        ("imu late", (0.03, 0.0), "imu_delay", ["imu_a"]),
        ("imu clock", (60.0, 0.0), "imu_no_overlap", ["imu_a"]),
        ("effort", (0.0, 0.0), "effort_is_current", ["elbow", "shoulder_lift"]),
    ],
)
def test_faults_of_mcap_logs(
    fault: str, late: tuple[float, float], code: str, joints: list[str], tmp_path: Path
) -> None:
    made = messages(*late)
    if fault == "stamps":
        for _, _, content in made:
            content.header.stamp = SimpleNamespace(sec=0, nanosec=0)
    log = write_messages(tmp_path / "log.mcap", made, encoding="cdr")
    shutil.copy(FOLDER / "six_joint.urdf", tmp_path)
    text = (FOLDER / "robot.toml").read_text()
    said = "" if fault == "effort" else 'effort = "current"'
    (tmp_path / "robot.toml").write_text(text.replace('effort = "current"', said))
    report = inspect_log(log, load_robot(tmp_path / "robot.toml"))
    assert sorted((f.code, f.joint) for f in report.findings) == [(code, j) for j in joints]
