"""One cut-off per identification, carried by the file; one rate, though samples are
lost.
"""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from seqid_cli.commands.app import run
from seqid_cli.errors import InputError
from seqid_cli.identify.common_cutoff import identification_options
from seqid_cli.identify.options import RigidOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.plants.sensors import quantise
from tests.unit.logs.writers import write_parquet

SAMPLES = ROOT / "sample_logs" / "six_joint"
LOGS = sorted((SAMPLES / "inertia").glob("*.parquet"))
INERTIA, COULOMB, VISCOUS = 0.4, 2.0, 1.5
DH = "dh = { alpha = 0.0, a = 0.0, d = 0.1, theta0 = 0.0 }"
HEAD = 'schema = "seqid/robot@1"\nname = "one"\ngravity = [0.0, 0.0, -9.81]\n'
ROBOT = f'{HEAD}[[joint]]\nname = "base"\n{DH}\n'


def write_log(path: Path, rate_hz: float, lost: int, seed: int) -> Path:
    """A joint about a vertical axis; every 120 ms some rows are lost, not so the
    stamps.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 1.0 / rate_hz)
    w, size = np.array([0.9, 2.3, 4.1]), np.array([0.8, 0.5, 0.25])
    angle = w * t[:, None] + rng.uniform(0.0, 6.0, 3)
    q, dq = np.sin(angle) @ size, np.cos(angle) @ (size * w)
    ddq = -np.sin(angle) @ (size * w**2)
    tau = INERTIA * ddq + COULOMB * np.tanh(dq / 0.01) + VISCOUS * dq
    tau += rng.normal(0.0, 0.1, len(t))
    kept = np.arange(len(t)) % round(0.12 * rate_hz) >= lost
    q, dq, tau = (x[kept, None] for x in (quantise(q, 2e-5), dq, tau))
    return write_parquet(path, t[: kept.sum()], ["base"], q, dq=dq, torque=tau)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    (tmp_path / "robot.toml").write_text(ROBOT)
    return load_robot(tmp_path / "robot.toml")


def test_the_order_of_the_logs_does_not_matter() -> None:
    arm, options = load_robot(SAMPLES / "robot.toml"), RigidOptions(source="encoder")
    first, other = (
        identification_options(x, arm, options, None) for x in (LOGS[:3], LOGS[2::-1])
    )
    assert first == other
    assert "3 logs together" in first.origin


@pytest.mark.usefixtures("robot")
def test_predict_takes_the_files_cutoff(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [
        write_log(tmp_path / f"{k}.parquet", rate, 0, k)
        for k, rate in enumerate((250, 1000))
    ]
    arm, out = ["-r", str(tmp_path / "robot.toml")], tmp_path / "model.json"
    assert run(["simultaneous", *map(str, logs), *arm, "-o", str(out)]) == 0
    stages = read_parameters(out).stages
    assert len({use.cutoff_hz for use in stages.inertia.motion_use}) == 1
    assert stages.friction.cutoff_hz == stages.inertia.cutoff_hz
    for given, hz in (([], stages.inertia.cutoff_hz), (["--cutoff", "7"], 7.0)):
        arguments = [
            *arm,
            "-p",
            str(out),
            "-o",
            str(tmp_path / "prediction.json"),
            *given,
        ]
        assert run(["predict", *map(str, logs), *arguments]) == 0
        text = (tmp_path / "prediction.json").read_bytes()
        file = msgspec.json.decode(text, type=PredictionFile)
        assert [log.cutoff_hz for log in file.logs] == [hz, hz]
        assert file.cutoff_origin == ("as given" if given else "of the inertia stage")
        assert "cut-off: " in capsys.readouterr().err


def test_a_log_too_slow_for_the_cutoff_says_what_it_allows(
    robot: Robot, tmp_path: Path
) -> None:
    recording = read_recording(write_log(tmp_path / "slow.parquet", 25.0, 0, 1), robot)
    options = MotionOptions(12.0, origin="of the inertia stage")
    with pytest.raises(
        InputError, match=r"the highest that this log allows is 6.25 Hz"
    ):
        estimate_motion(recording, robot, options)
    assert estimate_motion(
        recording, robot, MotionOptions(6.0, origin=options.origin)
    ).samples


@pytest.mark.parametrize(
    "rate_hz",
    [500.0, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (250.0, 1000.0))],
)
def test_samples_that_are_lost_without_the_stamps_showing_it(
    robot: Robot, tmp_path: Path, rate_hz: float
) -> None:
    found = []
    for lost in (0, round(0.03 * rate_hz)):
        log = write_log(tmp_path / f"{lost}.parquet", rate_hz, lost, seed=4)
        logs = [read_recording(log, robot)]
        found.append(identify_simultaneous(logs, robot, options=MotionOptions())[1])
    whole, lossy = (stage.parameters[-1].value for stage in found)
    assert whole == pytest.approx(INERTIA, rel=0.02)
    # A quarter of the time is gone: on the stamps as logged the inertia comes out 40 %
    # too small.
    assert lossy == pytest.approx(INERTIA, rel=0.05)
    assert not found[0].motion_use[0].warnings
    assert "samples are lost" in found[1].motion_use[0].warnings[0]
