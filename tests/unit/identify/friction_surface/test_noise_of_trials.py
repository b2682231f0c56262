"""A search for sizes that ended among differences of huge numbers."""

from pathlib import Path

import pytest

from seqid_cli import identify
from seqid_cli.identify.nuisances import term_of
from seqid_cli.params.io import read_parameters
from tests.studies.outside.cases import SPEEDS, Recorder
from tests.studies.outside.groups import GROUPS

SEED = 10226  # an arm with waves of friction at its second joint


@pytest.mark.slow
def test_the_noise_is_no_less_than_what_is_left_of_trials(tmp_path: Path) -> None:
    """Far below it the likelihood was rounding: a delay of 10,589 s came out."""
    case = GROUPS["singles"](SEED)
    recorder = Recorder(case, tmp_path)
    trials = recorder.trials(SPEEDS, case.before)
    friction = tmp_path / "friction.json"
    identify.friction(trials, recorder.robot, output=friction)
    stage = read_parameters(friction).stages.friction
    assert stage is not None
    for joint in stage.joints.values():
        delay = term_of(joint, "delay")
        assert delay is not None
        assert abs(delay.value) < 5e-3
        assert joint.rmse < 0.05
