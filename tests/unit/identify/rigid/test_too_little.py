"""Logs too short, or in which joints stand: said so, and nothing of gravity there."""

from pathlib import Path

import pytest

from seqid_cli.identify.functions import simultaneous
from seqid_cli.params.schema import RigidStage
from tests.unit.inspect.faults import SAMPLES, SIX_ROBOT, read_columns, write_columns


def identified(folder: Path, log: str, first: int, count: int) -> RigidStage:
    columns = {
        name: values[first : first + count]
        for name, values in read_columns(SAMPLES / "six_joint" / log).items()
        if "imu" not in name
    }
    path = folder / "log.parquet"
    write_columns(path, columns)
    stage = simultaneous([path], SIX_ROBOT).stages.inertia
    assert stage is not None
    return stage


@pytest.mark.slow
def test_joints_that_stand_have_no_error_and_no_gravity(tmp_path: Path) -> None:
    stage = identified(tmp_path, "friction/elbow.parquet", 0, 8000)
    assert set(stage.rmse) == {"elbow"}
    reasons = {
        v.joint: v.reason for v in stage.verdicts if v.joint not in ("", "elbow")
    }
    assert set(reasons.values()) == {"does not move"}


def test_a_log_of_a_second_is_too_short(tmp_path: Path) -> None:
    stage = identified(tmp_path, "validation/fourier_1.parquet", 1000, 160)
    assert stage.parameters == []
    assert "too short" in stage.verdicts[-1].reason
