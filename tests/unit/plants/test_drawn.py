"""Drawn arms whose joints slide: they obey mechanics, and their robot files say what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests.plants.arms.drawn import SLIDING, drawn_arm
from tests.plants.mechanics.rigid import Rigid
from tests.plants.robotfile import robot_toml
from tests.plants.simulate import Plant
from tests.unit.plants.test_plants import fall


@pytest.fixture(params=range(SLIDING, SLIDING + 4))
def plant(request: pytest.FixtureRequest) -> Plant:
    """One of the arms with a joint that slides."""
    return drawn_arm(int(request.param))


def test_energy_is_conserved_where_joints_slide(plant: Plant) -> None:
    """Kinetic plus potential energy stays while the arm falls."""
    q, dq = fall(plant, 0.4, 4000.0)
    rigid, still = Rigid(plant.arm), np.zeros(plant.arm.n)
    total = np.array([rigid.energy(a, b) for a, b in zip(q[::50], dq[::50], strict=True)])
    moved = abs(rigid.energy(q[-1], still) - rigid.energy(q[0], still))
    assert moved > 1e-4
    assert np.abs(total - total[0]).max() < 5e-3 * moved


def test_the_robot_file_says_which_joints_slide(plant: Plant, tmp_path: Path) -> None:
    """The package, reading it, has the plant's torques."""
    path = tmp_path / "robot.toml"
    path.write_text(robot_toml("arm", plant), encoding="ascii")
    robot = load_robot(path)
    assert tuple(np.flatnonzero(robot.chain.prismatic)) == plant.arm.slides
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 5, plant.arm.n))
    rotorless = Rigid(replace(plant.arm, rotor_inertia=np.zeros(plant.arm.n)))
    truth = [rotorless.inverse(*state) for state in zip(q, dq, ddq, strict=True)]
    gravity = np.asarray(robot.gravity)
    found = inverse_dynamics(robot.chain, gravity, plant.arm.phi, q, dq, ddq)
    assert found == pytest.approx(np.array(truth), rel=1e-9, abs=1e-9)
