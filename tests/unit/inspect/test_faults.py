"""Every planted fault leads to its own finding, at the right joint, and to no other."""

import shutil
from collections.abc import Sequence
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.inspect.findings import ERRORS
from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.kinematics import link_motion
from tests.plants.robots.sample import sample_robot
from tests.unit.inspect import faults as table
from tests.unit.inspect.faults import SAMPLES, SINGLE, SIX, Fault, read_columns
from tests.unit.inspect.planting import Columns
from tests.unit.logs.writers import Message, arm_messages, write_messages

SEED = 5


def inspect_planted(faults: Sequence[Fault], folder: Path) -> InspectionFile:
    first = faults[0]
    ((*base, without_imus, triad),) = {
        (f.rig, f.base, f.without_imus, f.triad) for f in faults
    }
    columns = {
        n: x.copy() for n, x in sound_columns(*base, without_imus, triad).items()
    }
    text = (SAMPLES / first.rig / "robot.toml").read_text()
    end = text.index("[channels]") if "[channels]" in text else len(text)
    if triad:
        imu = 'name = "imu_b"\nafter_joint = "wrist_3"\ngyro = true\n\n'
        text = text[: text.index('name = "imu_b"')] + imu + text[end:]
    elif without_imus:
        text = text[: text.index("[[imu]]")] + text[end:]
    for fault in faults:
        for old, new in fault.robot.items():
            assert old in text
            text = text.replace(old, new)
        fault.plant(columns, np.random.default_rng(SEED))
    table.write_columns(folder / "log.parquet", columns)
    for urdf in (SAMPLES / first.rig).glob("*.urdf"):
        shutil.copy(urdf, folder)
    (folder / "robot.toml").write_text(text)
    return inspect_logs([folder / "log.parquet"], load_robot(folder / "robot.toml"))


@cache
def sound_columns(rig: str, base: str, without_imus: bool, triad: bool) -> Columns:
    columns = read_columns(SAMPLES / rig / f"{base}.parquet")
    if without_imus:
        columns = {
            name: values for name, values in columns.items() if "imu" not in name
        }
    if rig == "six_joint" and base != SINGLE:
        add_velocities_and_temperatures(columns)
    if base == SINGLE:  # a third of the speeds is enough
        columns = {name: values[: len(values) // 3] for name, values in columns.items()}
    if triad:
        turn_into_triad(columns)
    return columns


def add_velocities_and_temperatures(columns: Columns) -> None:
    kernel = np.hanning(9) / np.hanning(9).sum()
    for k, name in enumerate(SIX):
        slope = np.gradient(columns[f"{name}.position"], columns["t"])
        columns[f"{name}.velocity"] = np.convolve(slope, kernel, mode="same")
        columns[f"{name}.temperature"] = 30.0 + k + 0.01 * np.round(columns["t"])


def turn_into_triad(columns: Columns) -> None:
    """Make of the array imu_b an ordinary IMU: its triad at the origin, and a gyro
    beside it.
    """
    t, robot, rng = columns["t"], sample_robot("six_joint"), np.random.default_rng(SEED)
    q = np.column_stack([columns[f"{name}.position"] for name in SIX])
    dq = np.gradient(q, t, axis=0)
    dq = np.apply_along_axis(
        lambda x: np.convolve(x, np.hanning(11) / 5.0, "same"), 0, dq
    )
    w = link_motion(robot.chain, robot.gravity, q.T, dq.T, np.zeros_like(dq.T)).w[-1].T
    array = [columns.pop(f"imu_b.a{k}") for k in range(1, 13)]
    for k, axis in enumerate("xyz"):
        columns[f"imu_b.a{axis}"] = array[k]
        columns[f"imu_b.g{axis}"] = w[:, k] + rng.normal(0.0, 0.003, len(t))


# Those that share a log are many faults in few inspections: `make test` has them.
@pytest.mark.parametrize(
    "faults",
    [
        pytest.param(
            own, id=own[0].name, marks=[] if len(own) > 1 else [pytest.mark.slow]
        )
        for own in table.groups()
    ],
)
def test_a_planted_fault_is_found_and_nothing_else(
    faults: list[Fault], tmp_path: Path
) -> None:
    report = inspect_planted(faults, tmp_path)
    found = {
        (finding.code, finding.joint, finding.message) for finding in report.findings
    }
    assert {code for code, _, _ in found} == {fault.code for fault in faults}, found
    for fault in faults:
        mine = [
            f for f in report.findings if (f.code, f.joint) == (fault.code, fault.joint)
        ]
        assert mine, (fault.name, found)
        if fault.channel is not None:
            assert [finding.channel for finding in mine] == [fault.channel]
    # one channel each, so one finding each
    if len(faults) > 1 or faults[0].channel is not None:
        assert len(report.findings) == len(faults), found
    faulty = any(fault.code in ERRORS for fault in faults)
    assert report.verdict == ("faulty" if faulty else "usable")
    assert all(finding.remedy and finding.message for finding in report.findings)


FOLDER = SAMPLES / "six_joint"


def messages(imu_late_s: float, log_late_s: float) -> list[Message]:
    """Of joints and of imu_a; the robot file has another IMU, which a log need not
    have.
    """
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    columns = {name: values[:1000] for name, values in columns.items()}
    q, effort, array = (
        np.column_stack(
            [values for name, values in columns.items() if fnmatch(name, pattern)]
        )
        for pattern in ("*.position", "*.current", "imu_a.*")
    )
    joints = arm_messages(columns["t"], SIX, q, effort=effort)
    array = {"imu_a": array}
    both = arm_messages(columns["t"] + imu_late_s, SIX, q, accelerometers=array)
    made = joints + [message for message in both if message[0] != "/joint_states"]
    late = round(log_late_s * 1e9)
    return sorted(
        ((topic, at + late, x) for topic, at, x in made), key=lambda message: message[1]
    )


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
    assert sorted((f.code, f.joint) for f in report.findings) == [
        (code, j) for j in joints
    ]
