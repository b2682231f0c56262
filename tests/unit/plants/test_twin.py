"""The second simulator: its bodies against closed-form equations and Pinocchio, its time steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.plants import twin
from tests.plants.arms.rigs import one_joint, six_joint, two_joint
from tests.plants.mechanics.rigid import Rigid
from tests.plants.motions.experiments import inertia_trials
from tests.plants.simulate import Plant
from tests.studies.coverage.cases import Case, draw


@pytest.mark.parametrize("plant", [one_joint(), two_joint(), six_joint()])
@pytest.mark.parametrize("coupled", [False, True])
def test_bodies_are_those_of_pinocchio(plant: Plant, coupled: bool) -> None:
    arm = replace(plant.arm, rotor_coupling=coupled)
    for state in np.random.default_rng(0).standard_normal((20, 3, arm.n)):
        expected = Rigid(arm).inverse(*state)
        assert twin.inverse(arm, *state) == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_rows_satisfy_the_equation_of_motion() -> None:
    """Torque of the motion plus friction is the motor's torque, at every row."""
    drawn = draw(Case("planar", 1, "white", "fine"))
    trial = inertia_trials(drawn.plant, [np.zeros(2)], np.random.default_rng(3), seconds=4.0)[0]
    truth = twin.simulate(drawn.plant, trial.reference, 0, every=4).truth
    rows = range(len(truth.q))
    motion = [twin.inverse(drawn.plant.arm, truth.q[k], truth.dq[k], truth.ddq[k]) for k in rows]
    left = truth.tau - truth.friction - np.array(motion)
    size = np.sqrt(np.mean(truth.tau**2, axis=0))
    assert (np.sqrt(np.mean(left**2, axis=0)) < 5e-4 * size).all()
