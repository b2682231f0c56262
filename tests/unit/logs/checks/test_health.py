"""Checks of units: they fire on the wrong unit and stay silent on the right one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.logs.read import read_recording
from seqid_cli.robot.types import Imu
from tests.unit.logs.samples import ARRAY, JOINTS, curve, grid, make_motion, make_robot
from tests.unit.logs.writers import write_parquet

DEGREES = 180.0 / np.pi
T = grid(500)
Q = curve(T, 3) * 1.2
DQ = np.gradient(Q, T, axis=0)


def warnings_of(tmp_path: Path, **channels: object) -> tuple[str, ...]:
    q = channels.pop("q", Q)
    limits = channels.pop("limits", None)
    imu: Imu = channels.pop("imu", ARRAY)  # type: ignore[assignment]
    robot = make_robot(imus=(imu,), limits=limits, constants=1.0)  # type: ignore[arg-type]
    path = write_parquet(tmp_path / "log.parquet", T, JOINTS, q, **channels)  # type: ignore[arg-type]
    return read_recording(path, robot).health.warnings


def test_right_units_are_silent(tmp_path: Path) -> None:
    accelerations = {"array": make_motion(T).accelerometers["array"]}
    found = warnings_of(
        tmp_path,
        dq=DQ,
        current=Q * 5 + 2 * np.sign(DQ),
        accelerometers=accelerations,
        limits=(-2.0, 2.0),
    )
    assert found == ()


@pytest.mark.parametrize(
    ("channels", "fragment"),
    [
        ({"q": Q * DEGREES, "limits": (-2.0, 2.0)}, "looks like degrees"),
        ({"q": Q * 3, "limits": (-2.0, 2.0)}, "Check zero and unit"),
        ({"q": Q * DEGREES, "dq": DQ}, "position looks like degrees"),
        ({"dq": DQ * DEGREES}, "velocity looks like deg/s"),
        ({"current": Q * 5000}, "looks like mA"),
        ({"torque": Q * [1.0, 0.0, 1.0]}, "torque of elbow is zero"),
    ],
)
def test_wrong_units_are_told(tmp_path: Path, channels: dict[str, object], fragment: str) -> None:
    assert any(fragment in warning for warning in warnings_of(tmp_path, **channels))


@pytest.mark.parametrize(("scale", "unit"), [(9.81, "looks like g,"), (9.81e-3, "looks like mg,")])
def test_accelerometers_in_g(tmp_path: Path, scale: float, unit: str) -> None:
    values = make_motion(T).accelerometers["array"] / scale
    found = warnings_of(tmp_path, accelerometers={"array": values})
    assert any(unit in warning for warning in found)


def test_time_in_other_units(tmp_path: Path) -> None:
    path = write_parquet(tmp_path / "log.parquet", T * 1000, JOINTS, Q)
    found = read_recording(path, make_robot()).health.warnings
    assert any("time is in seconds" in warning for warning in found)
