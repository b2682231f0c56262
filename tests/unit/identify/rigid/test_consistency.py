"""Parameters that bodies can have, where that is asked for at identification."""

import numpy as np
import pytest

from seqid_cli.identify.rigid.parameters import (
    made_consistent,
    parameters_of,
    representative_of,
)
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.model.torque import standard_parameters
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import free_basis, standard_names
from seqid_cli.robot.types import Robot
from tests.plants.arms.rigs import six_joint, two_joint
from tests.plants.robots.lab import robot_of, true_standard
from tests.plants.simulate import Plant


def stage_of(robot: Robot, plant: Plant, *, off: float, seed: int = 0) -> RigidStage:
    basis, standard = free_basis(robot), true_standard(plant)
    theta = basis.expression @ np.array(
        [standard[name] for name in standard_names(robot.n)]
    )
    error = 0.02 * np.abs(theta) + 0.02 * np.median(np.abs(theta))
    theta = theta + off * error * np.random.default_rng(seed).standard_normal(
        len(theta)
    )
    covariance, size = np.diag(error**2), basis.size
    return RigidStage(
        parameters=parameters_of(robot, basis, np.arange(size), theta, covariance),
        representative=representative_of(basis, theta, np.zeros(robot.n)),
        covariance=covariance.tolist(),
        **{"condition": 1.0, "rank": size, "structural_rank": size},
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_the_constrained_parameters_are_those_of_bodies(seed: int) -> None:
    plant = six_joint()
    robot = robot_of("six", plant)
    noisy = stage_of(robot, plant, off=3.0, seed=seed)
    stage = made_consistent(noisy, Stages(), robot)
    for each, bodies in ((noisy, False), (stage, True)):
        links, rotor = standard_parameters(each, robot.n)
        least = min(
            float(np.linalg.eigvalsh(pseudo_inertia(links)).min()), float(rotor.min())
        )
        assert (least >= 0) is bodies
    values = free_basis(robot).expression @ np.concatenate([links.ravel(), rotor])
    np.testing.assert_allclose(
        [p.value for p in stage.parameters], values, rtol=1e-6, atol=1e-9
    )
    assert "standard errors" in stage.notes[-1]


def test_parameters_that_bodies_have_stay_as_they_are() -> None:
    plant = two_joint()
    robot = robot_of("two", plant)
    given = stage_of(robot, plant, off=0.0)
    stage = made_consistent(given, Stages(), robot)
    for p, q in zip(given.parameters, stage.parameters, strict=True):
        assert q.value == pytest.approx(p.value, abs=0.01 * p.std_error)
    assert stage.notes[-1].startswith("physically consistent as identified")
