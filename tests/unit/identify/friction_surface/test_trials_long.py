"""Trials of a log that is passed over are those of the held log, to the last bit."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.friction_surface.trials import Trial, trials_of
from seqid_cli.identify.regression import equations
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.tables import parquet
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.seven_joint import JOINTS, RESOLUTION, write_arm

RATE = 1000
PAUSE_S, REACH, ACCELERATION = 0.4, 0.5, 4.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_arm(tmp_path_factory.mktemp("arm")))


def trapezoid(speed: float) -> np.ndarray:
    """Positions of a move by `REACH` at a speed, and back, with pauses."""
    up = speed**2 / (2 * ACCELERATION)
    times = np.cumsum([0.0, speed / ACCELERATION, (REACH - 2 * up) / speed, speed / ACCELERATION])
    t = np.arange(0.0, times[-1], 1 / RATE)
    velocity = np.interp(t, times, [0.0, speed, speed, 0.0])
    ahead = np.cumsum(velocity) / RATE
    pause = np.zeros(int(PAUSE_S * RATE))
    return np.concatenate([pause, ahead, pause + ahead[-1], ahead[-1] - ahead])


def write(path: Path, *, waving: bool) -> Path:
    """Moves of one joint after the other; `waving` without a pause for a long time."""
    rng = np.random.default_rng(3)
    parts = []
    for joint in (0, 2, 5):
        for speed in (0.2, 0.7, 1.0):
            part = np.zeros((len(wave := trapezoid(speed)), len(JOINTS)))
            part[:, joint] = wave
            parts.append(part)
    if waving:
        steps = np.arange(30 * RATE) / RATE
        part = np.zeros((len(steps), len(JOINTS)))
        part[:, 1] = 0.4 * np.abs((steps / 2.0) % 2 - 1) - 0.4
        parts.insert(4, part)
    q = np.concatenate(parts)
    tau = rng.normal(size=q.shape) + 2.0 * np.sign(np.gradient(q, axis=0))
    columns = {"t": np.arange(len(q)) / RATE}
    counted = RESOLUTION * np.round(q / RESOLUTION)
    columns |= {f"{name}.position": counted[:, j] for j, name in enumerate(JOINTS)}
    columns |= {f"{name}.torque": tau[:, j] for j, name in enumerate(JOINTS)}
    pq.write_table(pa.table(columns), path)
    return path


def parts_of(path: Path, robot: Robot, rows: int) -> tuple[list[Trial], list[Trial]]:
    """Return the trials of the log passed over, and those of the held one."""
    log = equations.open_if_long(path, robot)
    assert isinstance(log, SurveyedLog)
    held = read_recording(path, robot)
    return trials_of(robot, log, 0, rows=rows), trials_of(robot, held, 0)


@pytest.mark.slow
@pytest.mark.parametrize("waving", [False, True])
@pytest.mark.parametrize("rows", [1_000, 5_000, 20_000])
def test_the_trials_are_those_of_the_held_log(
    waving: bool, rows: int, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(equations, "LONG", 1_000)
    monkeypatch.setattr(parquet, "BLOCK_ROWS", 3_000)
    found, expected = parts_of(write(tmp_path / "log.parquet", waving=waving), robot, rows)
    assert len(found) == len(expected) > 10
    for own, other in zip(found, expected, strict=True):
        assert (own.joint, own.velocity, own.weight) == (other.joint, other.velocity, other.weight)
        for name in ("t", "q", "dq", "ddq", "tau", "configuration"):
            np.testing.assert_array_equal(getattr(own, name), getattr(other, name))
        for name in ("q", "dq", "ddq", "tau"):
            np.testing.assert_array_equal(getattr(own.ramps, name), getattr(other.ramps, name))
            assert getattr(own.ramps, name).base is None  # no trial keeps its log alive
