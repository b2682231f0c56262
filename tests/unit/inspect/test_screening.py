"""Logs that stages read: damaged samples are gone; long logs are told the same as short
ones.
"""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.identify.functions import simultaneous
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.inspect.screening import open_screened, read_screened, screened_long
from seqid_cli.logs.long import open_if_long
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.unit.inspect import planting as p
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

RIG = SAMPLES / "one_joint"
LOG = RIG / "validation" / "fourier_1.parquet"
POSITION, CURRENT = "joint_1.position", "joint_1.current"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(RIG / "robot.toml")


SPIKES, SIGN = p.spikes(POSITION, 0.3), p.negated(CURRENT)

PLANTED = {
    "": p.nothing,
    "position_spikes": SPIKES,
    " position_spikes": p.spikes(POSITION, -0.15),
    "sign_mismatch": SIGN,
    "position_spikes sign_mismatch": p.both(SPIKES, SIGN),
}


@pytest.mark.slow
@pytest.mark.parametrize("told", PLANTED)
def test_stages_hear_what_inspect_calls_an_error(
    robot: Robot, tmp_path: Path, told: str
) -> None:
    codes, columns = set(told.split()), read_columns(LOG)
    PLANTED[told](columns, np.random.default_rng(3))
    path = tmp_path / "log.parquet"
    write_columns(path, columns)
    errors = {
        f.code for f in inspect_log(path, robot).findings if f.severity == "error"
    }
    held, opened = read_screened(path, robot), open_if_long(path, robot, least=1)
    log, findings = screened_long(opened, robot)
    for told in (held.findings, findings):
        expected = {(code, "joint_1", str(path)) for code in codes}
        assert {(f.code, f.joint, f.log) for f in told} == expected
    assert errors == codes
    sound, damaged = (read_recording(each, robot).q for each in (LOG, path))
    assert (np.abs(damaged - sound).max() > 0.1) == ("position_spikes" in codes)
    for q in (held.recording.q, np.concatenate([block.q for block in log.blocks()])):
        assert np.abs(q - sound).max() < 0.06  # bridged, not what was there


def test_time_in_another_unit_is_refused_with_and_without_checks(
    robot: Robot, tmp_path: Path
) -> None:
    columns = read_columns(LOG)
    columns["t"] = 1000.0 * columns["t"]
    path = tmp_path / "log.parquet"
    write_columns(path, columns)
    for checks in (True, False):
        with pytest.raises(InputError, match="looks like ms") as refused:
            open_screened(path, robot, checks=checks)
        assert 'time_unit = "ms"' in refused.value.hint
    with pytest.raises(InputError, match="looks like ms"):
        simultaneous([path], robot)
