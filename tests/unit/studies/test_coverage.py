"""The coverage study: its arithmetic, its truths, its seeds and its results file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.plants.arms.rigs import plain
from tests.plants.motions.experiments import friction_trials, gravity_trials
from tests.studies.coverage.cases import Case, draw, record
from tests.studies.coverage.score import compare, identified
from tests.studies.coverage.study import coverage as coverage_of
from tests.studies.coverage.study import kind_of
from tests.studies.records import seeds_of


def test_honest_errors_are_covered_and_halved_ones_are_not() -> None:
    z = list(np.random.default_rng(1).standard_normal((300, 4)))
    honest, halved = coverage_of(z), coverage_of([2 * x for x in z])
    assert honest.low < 0.95 < honest.high
    assert honest.rms == pytest.approx(1.0, abs=0.05)
    assert halved.high < 0.75


@pytest.mark.parametrize("text", ["990:1010", "500:20000", "2000:2100", "9999:10001"])
def test_seeds_for_tuning_and_for_judging_are_not_mixed(text: str) -> None:
    with pytest.raises(SystemExit, match="not both"):
        kind_of(seeds_of(text))


def test_identification_without_noise_recovers_the_truths(tmp_path: Path) -> None:
    """Truths by hand for two links in a tilted plane; the stages leave 1 % without
    noise.
    """
    case = Case("planar", 4, "white", "fine")
    drawn = draw(case)
    plant = replace(drawn.plant, friction=plain(drawn.plant.friction))  # type: ignore[arg-type]
    still = np.zeros(plant.arm.n)
    plant = replace(plant, current_noise=still, current_step=0.0, imus=())
    plant = replace(plant, encoder_step=plant.encoder_step / 64)
    # Friction is plain, so that few speeds, and none of the slowest, show all of it.
    postures = [np.array([0.0, angle]) for angle in (0.0, 1.2)]
    trials = [
        *friction_trials(plant, postures[0], speeds=5, lowest=0.3),
        *gravity_trials(plant, postures, speeds=(0.5,)),
        *(trial for trial in drawn.trials if trial.stage == "inertia"),
    ]
    record(case, replace(drawn, plant=plant, trials=trials), tmp_path)
    stages, problem = identified(tmp_path)
    assert not problem
    arm, length = plant.arm, float(plant.arm.dh[1, 1])
    truth = {
        "mx_1": arm.phi[0, 1] + arm.phi[1, 0] * length,
        "my_1": arm.phi[0, 2],
        "mx_2": arm.phi[1, 1],
        "my_2": arm.phi[1, 2],
        "Izz_1": arm.phi[0, 9] + arm.phi[1, 0] * length**2,
        "Izz_2": arm.phi[1, 9],
    }
    rows = [
        x for x in compare(case, plant, stages) if x["group"] in ("gravity", "inertia")
    ]
    assert len(rows) == 6
    for found in rows:
        assert found["truth"] == pytest.approx(truth[found["name"]], rel=1e-12)
        scale = truth[found["name"].replace("my", "mx")]
        assert abs(found["estimate"] - found["truth"]) < 1e-2 * scale, found["name"]
