"""Parameters of what lies between motor and link, where nobody knows the rotor's inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.robot.types import Robot
from tests.plants.robots.two_joint import two_joint_robot

SETTINGS = {
    "joint_elasticity": {"trial_stiffness": 900.0, "encoder_side": 0.0, "damping_ratio": 0.15},
    "backlash": {"trial_gap": 1e-3},
}


@pytest.fixture(params=SETTINGS)
def effect(request: pytest.FixtureRequest) -> Effect:
    return CATALOGUE[str(request.param)]


def without_rotors(robot: Robot) -> Robot:
    return replace(robot, joints=tuple(replace(x, rotor_inertia=None) for x in robot.joints))


def test_they_are_stated_where_the_robot_file_has_it(effect: Effect) -> None:
    robot = two_joint_robot()
    (value,) = effect.reported(robot, 0, SETTINGS[effect.name], np.array([1e-3]), np.eye(1))
    assert value.value > 0.0
    assert not effect.lacking(robot, 0)


def test_they_are_not_where_it_is_one_with_the_links(effect: Effect) -> None:
    """The first joint turns both alike in every motion; of the second it depends on the arm."""
    robot = without_rotors(two_joint_robot())
    assert effect.reported(robot, 0, SETTINGS[effect.name], np.array([1e-3]), np.eye(1)) == []
    assert "rotor_inertia" in effect.lacking(robot, 0)
    assert robot.joint_names[0] in effect.lacking(robot, 0)
    assert effect.reported(robot, 1, SETTINGS[effect.name], np.array([1e-3]), np.eye(1))
