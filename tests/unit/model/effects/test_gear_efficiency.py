"""Losses in either power direction, from motor torque that an efficiency divides or multiplies."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.gear_efficiency import GearEfficiency
from tests.plants.robots.two_joint import GEAR, ROTOR, torque_model, two_joint_robot
from tests.unit.model.effects.fitting import FINE_HZ, Array, direction, fit, trial

FORWARD, BACKWARD = 0.82, 0.91


def link_torque(q: Array, dq: Array) -> Array:
    """Torque (N, n) N m behind the gears."""
    ddq = np.gradient(dq, 1.0 / FINE_HZ, axis=0)
    robot = two_joint_robot()
    whole = torque_model(robot).rigid(q, dq, ddq)
    return whole - np.square(GEAR) * ROTOR * ddq


def lossy(t: Array, q: Array, dq: Array) -> Array:
    """Motor torque beyond the link's: the motor gives more, or the link drives it less."""
    load = link_torque(q, dq)
    power = load * dq
    motor = np.where(power > 0, load / FORWARD, np.where(power < 0, load * BACKWARD, load))
    return motor - load + 2.0 * direction(dq) + 0.3 * dq


@pytest.mark.parametrize("joint", [0, 1])
def test_efficiencies_come_back(joint: int) -> None:
    effect = GearEfficiency()
    trials = [trial(lossy, seed=k, noise=0.2) for k in range(2)]
    found = fit(effect, trials, joint)
    robot = trials[0].scene.robot
    values = {v.name: v for v in effect.values(robot, joint, {}, found.c, 1e-6 * np.eye(2))}
    assert found.c == pytest.approx([1 / FORWARD - 1, 1 - BACKWARD], rel=0.05)
    assert values["driving_efficiency"].value == pytest.approx(FORWARD, rel=0.01)
    assert values["backdriving_efficiency"].value == pytest.approx(BACKWARD, rel=0.01)
    assert values["driving_efficiency"].std_error == pytest.approx(FORWARD**2 * 1e-3, rel=0.03)
    assert found.left < 0.05
