"""Settings of inspection hold in every part of a log, and in worker processes."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect import InspectSettings, inspect
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.screening import read_screened
from seqid_cli.inspect.settings import ChannelSettings
from seqid_cli.logs.read import read_both
from seqid_cli.robot.file import load_robot
from seqid_cli.scale import ordered, processes
from tests.unit.inspect import planting as p
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

RIG = SAMPLES / "one_joint"
LOG = RIG / "validation" / "fourier_1.parquet"
# A sixth of the values are missing: far more than by default, and less than this.
LOOSE = InspectSettings(channels=ChannelSettings(max_missing=0.5))


@pytest.fixture
def gappy(tmp_path: Path) -> Path:
    """A log whose current lacks values at uneven distances."""
    columns = read_columns(LOG)
    p.missing("joint_1.current", 0.15)(columns, np.random.default_rng(3))
    path = tmp_path / "log.parquet"
    write_columns(path, columns)
    return path


def codes(data: LogData) -> set[str]:
    return {finding.code for finding in check(data)[1]}


def test_a_setting_holds_and_stands_in_the_document(gappy: Path) -> None:
    robot = RIG / "robot.toml"
    usual = inspect(gappy, robot)
    loose = inspect(gappy, robot, settings=LOOSE)
    assert [finding.code for finding in usual.findings] == ["values_missing"]
    assert not loose.findings
    assert usual.settings is not None
    assert not usual.settings.changed
    assert usual.settings.values["channels.max_missing"] == 0.01
    assert loose.settings is not None
    assert loose.settings.changed == {"channels.max_missing": 0.5}


def test_a_setting_holds_in_worker_processes_as_in_this_one(gappy: Path) -> None:
    robot = load_robot(RIG / "robot.toml")
    recording, raw = read_both(gappy, robot)
    pieces = [
        LogData(recording=recording, raw=raw, robot=robot, settings=settings)
        for settings in (InspectSettings(), LOOSE)
    ]
    here = [codes(piece) for piece in pieces]
    with processes(2) as executor:
        there = [reply.get() for reply in ordered(executor, codes, pieces)]
    assert here == [{"values_missing"}, set()]
    assert there == here


def test_a_setting_holds_where_moves_of_a_plan_are_looked_for(tmp_path: Path) -> None:
    """What spoils a recorded move is found by the settings of `inspect`."""
    columns = read_columns(LOG)
    p.spikes("joint_1.current", 50.0)(columns, np.random.default_rng(3))
    path = tmp_path / "log.parquet"
    write_columns(path, columns)
    robot = load_robot(RIG / "robot.toml")
    blind = InspectSettings(channels=ChannelSettings(min_spike_share=100.0))
    found = [
        read_screened(path, robot, imus=False, settings=settings).findings
        for settings in (InspectSettings(), blind)
    ]
    assert "torque_spikes" in {finding.code for finding in found[0]}
    assert "torque_spikes" not in {finding.code for finding in found[1]}
