"""Recorded robots are read as they are."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.logs.read import read_recording
from seqid_cli.logs.storage.files import expand
from seqid_cli.robot.types import Channels, Robot
from tests import ROOT
from tests.unit.logs.samples import make_robot

DATA = ROOT / ".." / "shared" / "data"
POSITION, VELOCITY, CURRENT, TORQUE = "q_{index}", "dq_{index}", "current_{index}", "tau_{index}"
SIX = [f"joint_{i + 1}" for i in range(6)]
ROBOTS: dict[str, Robot] = {
    "dfki_simple_pendulum": make_robot(
        ["pivot"], channels=Channels(time="t", position=POSITION, velocity=VELOCITY, torque=TORQUE)
    ),
    "laas_cogging": make_robot(
        ["motor"],
        constants=1.0,
        channels=Channels(time="t", position=POSITION, velocity=VELOCITY, current=CURRENT),
    ),
    "staubli_tx40": make_robot(SIX, channels=Channels(time="t", position=POSITION, torque=TORQUE)),
    "ur10e_innopolis": make_robot(
        SIX,
        constants=0.11,
        gear_ratio=101.0,
        channels=Channels(time="t", position=POSITION, velocity=VELOCITY, current=CURRENT),
    ),
}
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason="the recorded data are not here"),
]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_log_is_read(name: str) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not here")
    robot = ROBOTS[name]
    paths = expand([str(DATA / name)])
    assert paths
    for recording in (read_recording(path, robot) for path in paths):
        table = pq.read_table(recording.path)
        t, q = table.column("t").to_numpy(), table.column("q_1").to_numpy()
        start, length = t[0], t[-1] - t[0]
        assert recording.tau is not None
        assert np.isfinite(recording.q).all()
        assert np.isfinite(recording.tau).all()
        assert recording.t[-1] == pytest.approx(length, abs=1.5 / recording.rate_hz)
        near = np.interp(recording.t, t - start, q)
        error = np.abs(recording.q[:, 0] - near)[recording.valid]
        assert np.quantile(error, 0.99) < 0.01
        assert recording.valid.mean() > (0.2 if "stopped" in recording.path.name else 0.99)


def test_uniform_log_is_taken_as_it_is() -> None:
    path = DATA / "staubli_tx40" / "holdout.parquet"
    if not path.exists():
        pytest.skip("staubli_tx40 is not here")
    recording = read_recording(path, ROBOTS["staubli_tx40"])
    table = pq.read_table(path)
    np.testing.assert_array_equal(recording.q[:, 3], table.column("q_4").to_numpy())
    assert recording.rate_hz == pytest.approx(5000.0)
    assert not recording.health.resampled
