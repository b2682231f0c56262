"""Settings hold in the processes that read logs as they do in this one."""

from concurrent.futures import Executor

import msgspec
import pytest

from seqid_cli import identify
from seqid_cli.identify.settings import ImuCalibSettings, MountingSettings
from seqid_cli.params.schema import ImuStage
from seqid_cli.scale import processes
from tests import ROOT

ONE_JOINT = ROOT / "sample_logs" / "one_joint"
LOWER = ImuCalibSettings(mounting=MountingSettings(max_cutoff=8.0))


def mounted(settings: ImuCalibSettings, executor: Executor | None) -> ImuStage:
    file = identify.imu_calib(
        ONE_JOINT / "imu",
        ONE_JOINT / "robot.toml",
        settings=settings,
        executor=executor,
    )
    stage = file.stages.imu
    assert stage is not None
    return stage


@pytest.mark.slow
def test_a_cut_off_that_is_set_is_that_of_all_processes() -> None:
    here = mounted(LOWER, None)
    with processes(2) as executor:
        there = mounted(LOWER, executor)
    assert msgspec.json.encode(there) == msgspec.json.encode(here)
    assert here.cutoff_hz == 8.0
    assert ImuCalibSettings().mounting.max_cutoff == 20.0
