"""Logs that stages read: damaged samples are gone; long logs are told the same as short ones."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.regression.equations import open_if_long
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.inspect.screening import read_screened, screened_long
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.unit.inspect import planting as p
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns
from tests.unit.inspect.planting import Plant

RIG = SAMPLES / "one_joint"
LOG = RIG / "validation" / "fourier_1.parquet"
POSITION, CURRENT = "joint_1.position", "joint_1.current"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(RIG / "robot.toml")


def planted(folder: Path, *plants: Plant) -> Path:
    columns = read_columns(LOG)
    for plant in plants:
        plant(columns, np.random.default_rng(3))
    write_columns(folder / "log.parquet", columns)
    return folder / "log.parquet"


@pytest.mark.parametrize("size", [0.3, -0.15])
def test_spikes_are_taken_out_and_said(robot: Robot, tmp_path: Path, size: float) -> None:
    path = planted(tmp_path, p.spikes(POSITION, size))
    sound, damaged = read_recording(LOG, robot), read_recording(path, robot)
    found = read_screened(path, robot)
    assert np.abs(damaged.q - sound.q).max() > 0.1
    assert np.abs(found.recording.q - sound.q).max() < 0.06  # bridged, not what was there
    (finding,) = found.findings
    assert (finding.code, finding.joint, finding.log) == ("position_spikes", "joint_1", str(path))


def test_what_inspect_calls_an_error_the_stages_hear(robot: Robot, tmp_path: Path) -> None:
    path = planted(tmp_path, p.negated(CURRENT))
    errors = {(f.code, f.joint) for f in inspect_log(path, robot).findings if f.severity == "error"}
    assert errors == {(f.code, f.joint) for f in read_screened(path, robot).findings}
    assert errors == {("sign_mismatch", "joint_1")}


@pytest.mark.parametrize(
    ("plants", "codes"),
    [
        ((), set()),
        ((p.spikes(POSITION, 0.3),), {"position_spikes"}),
        ((p.negated(CURRENT),), {"sign_mismatch"}),
        ((p.spikes(POSITION, 0.3), p.negated(CURRENT)), {"position_spikes", "sign_mismatch"}),
    ],
    ids=["sound", "spikes", "sign", "both"],
)
def test_a_log_that_is_passed_over_is_told_the_same(
    robot: Robot, tmp_path: Path, plants: tuple[Plant, ...], codes: set[str]
) -> None:
    path = planted(tmp_path, *plants)
    opened = open_if_long(path, robot, least=1)
    assert opened is not None
    log, findings = screened_long(opened, robot)
    assert {finding.code for finding in findings} == codes
    assert {finding.code for finding in read_screened(path, robot).findings} == codes
    q = np.concatenate([block.q for block in log.blocks()])
    assert np.abs(q - read_recording(LOG, robot).q).max() < 0.06


def test_a_hole_of_one_channel_is_left_out_and_told(robot: Robot, tmp_path: Path) -> None:
    def hole(columns: dict[str, np.ndarray], rng: np.random.Generator) -> None:
        columns[POSITION][500:600] = np.nan

    path = planted(tmp_path, hole)
    found = read_screened(path, robot)
    (finding,) = found.findings
    assert (finding.code, finding.joint, finding.channel) == ("channel_hole", "joint_1", "position")
    assert not found.recording.valid[510:590].any()
