"""Faults of MCAP logs: stamps, clocks, damage, what `effort` is."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.robot.file import load_robot
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns
from tests.unit.logs.writers import Message, imu_messages, joint_messages, write_messages

T0 = 1_767_225_600_000_000_000
Change = Callable[[list[Message]], list[Message]]


def messages(imu_shift_ns: int = 0) -> list[Message]:
    columns = read_columns(SAMPLES / "six_joint" / "validation" / "fourier_1.parquet")
    columns = {name: values[:1000] for name, values in columns.items()}
    stamps = T0 + np.rint(columns["t"] * 1e9).astype(np.int64)
    q = np.column_stack([columns[f"{name}.position"] for name in SIX])
    effort = np.column_stack([columns[f"{name}.current"] for name in SIX])
    made = joint_messages(stamps, SIX, q, effort=effort)
    for k in range(4):  # of imu_a; the robot file has another one, which a log need not have
        triad = np.column_stack([columns[f"imu_a.a{3 * k + i}"] for i in (1, 2, 3)])
        made += imu_messages(stamps + imu_shift_ns, f"/imu_a/accel_{k + 1}", triad)
    return sorted(made, key=lambda message: message[1])


def without_stamps(made: list[Message]) -> list[Message]:
    for _, _, content in made:
        content.header.stamp.sec = content.header.stamp.nanosec = 0
    return made


def logged_later(seconds: float) -> Change:
    def change(made: list[Message]) -> list[Message]:
        shift = round(seconds * 1e9)
        return [(topic, stamp + shift, content) for topic, stamp, content in made]

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "shift_s", "effort", "code", "joints"),
    [
        (list, 0.0, "current", "", []),
        (without_stamps, 0.0, "current", "stamps_zero", [""]),
        (logged_later(-0.5), 0.0, "current", "header_clock", [""]),
        (logged_later(3600.0), 0.0, "current", "header_clock", [""]),
        (list, 0.03, "current", "imu_delay", ["imu_a"]),
        (list, 60.0, "current", "imu_no_overlap", ["imu_a"]),
        (list, 0.0, "", "effort_is_current", ["elbow", "shoulder_lift"]),
    ],
    ids=["clean", "zero", "earlier", "hour", "imu late", "imu clock", "effort"],
)
def test_faults_of_mcap_logs(
    change: Change, shift_s: float, effort: str, code: str, joints: list[str], tmp_path: Path
) -> None:
    made = change(messages(round(shift_s * 1e9)))
    log = write_messages(tmp_path / "log.mcap", made, encoding="cdr")
    shutil.copy(SAMPLES / "six_joint" / "six_joint.urdf", tmp_path)
    text = (SAMPLES / "six_joint" / "robot.toml").read_text()
    said = f'effort = "{effort}"' if effort else ""
    (tmp_path / "robot.toml").write_text(text.replace('effort = "current"', said))
    report = inspect_log(log, load_robot(tmp_path / "robot.toml"))
    assert sorted((f.code, f.joint) for f in report.findings) == [(code, j) for j in joints]
