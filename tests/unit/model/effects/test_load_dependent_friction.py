"""Friction that grows with the load, told from friction that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.gear_load import ROTOR as REFLECTED
from seqid_cli.model.effects.load_dependent_friction import LoadDependentFriction
from seqid_cli.model.torque import TorqueModel
from seqid_cli.robot.base_parameters import STANDARD
from tests.plants.robots.two_joint import GEAR, ROTOR, torque_model, two_joint_robot
from tests.unit.model.effects.fitting import Array, direction, fit, trial
from tests.unit.model.effects.scenes import scene_of, wander
from tests.unit.model.effects.test_gear_efficiency import link_torque

SHARE = 0.08


def law(t: Array, q: Array, dq: Array) -> Array:
    """Tooth friction on top of a seal's."""
    return (2.0 + SHARE * np.abs(link_torque(q, dq))) * direction(dq) + 0.3 * dq


@pytest.mark.parametrize("joint", [0, 1])
def test_the_share_comes_back(joint: int) -> None:
    trials = [trial(law, seed=k, noise=0.2) for k in range(2)]
    found = fit(LoadDependentFriction(), trials, joint)
    assert found.c[0] == pytest.approx(SHARE, rel=0.05)
    assert found.left < 0.05


def test_without_a_rigid_body_there_is_no_load() -> None:
    robot = two_joint_robot()
    unknown = TorqueModel(robot, torque_model(robot).surfaces, None, None, "diagonal")
    effect, q = LoadDependentFriction(), wander(10.0)
    assert effect.available([scene_of(q)], 0)
    assert not effect.available([scene_of(q), scene_of(q, model=unknown)], 0)


def test_a_rotor_that_nobody_knows_does_not_load_the_gear() -> None:
    """The first joint's rotor stands in its link's inertia; what is lost tells them apart."""
    robot, reflected = two_joint_robot(), GEAR[0] ** 2 * ROTOR[0]
    first = replace(robot.joints[0], rotor_inertia=None)
    robot, model = replace(robot, joints=(first, *robot.joints[1:])), torque_model(robot)
    assert model.phi is not None
    assert model.rotor is not None
    lumped = model.phi.copy()
    lumped[0, STANDARD.index("Izz")] += reflected
    model = replace(model, robot=robot, phi=lumped, rotor=np.array([0.0, model.rotor[1]]))
    trials = [
        replace(one, scene=replace(one.scene, robot=robot, model=model))
        for one in (trial(law, seed=k, noise=0.2, top_hz=1.5) for k in range(2))
    ]
    found = fit(LoadDependentFriction(), trials, 0)
    assert found.c[0] == pytest.approx(SHARE, rel=0.05)
    assert found.settings[REFLECTED] == pytest.approx(reflected, rel=0.15)
