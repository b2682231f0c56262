"""Recorded robots, where the data lie beside the project: as good as fits made elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.plants.robots.sample import rmse

pytestmark = pytest.mark.slow

DATA = ROOT / ".." / "shared" / "data"

# RMS torque errors on the held-out log, N m, that least squares outside this project reached.
TX40 = (1.88, 4.28, 1.07, 0.62, 5.27, 2.20)
UR10E = (2.58, 3.77, 1.18, 0.39, 0.81, 0.63)
UR10E_TRAIN = (
    "identification__ur-20_02_12-50sec_12harm",
    "identification__ur-20_02_12-40sec_12harm",
    "identification__ur-20_02_10-30sec_12harm",
)


@pytest.mark.parametrize("own_cutoff", [True, False], ids=["own_cutoff", "same_cutoff"])
@pytest.mark.parametrize(
    ("folder", "train", "holdout", "reached", "cutoff_hz"),
    [
        ("staubli_tx40", ("train",), "holdout", TX40, 40.0),
        ("ur10e_innopolis", UR10E_TRAIN, "identification__ur-20_02_19_15harm50sec", UR10E, 5.0),
    ],
    ids=["tx40", "ur10e"],
)
def test_a_held_out_log_is_predicted_as_well_as_elsewhere(
    *,
    folder: str,
    train: tuple[str, ...],
    holdout: str,
    reached: tuple[float, ...],
    cutoff_hz: float,
    own_cutoff: bool,
) -> None:
    """With the low-pass that the other fits used, and with the one chosen from the log."""
    home = DATA / folder
    if not home.exists():
        pytest.skip("recorded data are not beside the project")
    robot = load_robot(home / "robot.toml")
    options = InertiaOptions(motion=MotionOptions(None if own_cutoff else cutoff_hz))
    logs = [read_recording(home / f"{name}.parquet", robot) for name in train]
    friction, inertia = identify_simultaneous(logs, robot, options=options.motion)
    stages = Stages(friction=friction, inertia=inertia)
    held_out = [read_recording(home / f"{holdout}.parquet", robot)]
    error = rmse(list(predict(held_out, robot, stages, options=options)))
    assert (np.round(error, 2) <= reached).all(), error
