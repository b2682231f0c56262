"""A motor that turns with two joints."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.transmission_coupling import TransmissionCoupling
from tests.plants.robots.two_joint import SIGN_WIDTH, two_joint_robot
from tests.unit.model.effects.added import scenes_with
from tests.unit.model.effects.fitting import FINE_HZ, Array, Law
from tests.unit.model.effects.measured import fitted
from tests.unit.model.effects.scenes import scene_of, wander

COULOMB, VISCOUS, INERTIA = 2.1, 0.6, 0.05
RATIOS = (1.0, -1.0, 0.3, -0.3)


def friction_and_inertia(rate: Array) -> Array:
    change = np.gradient(rate, 1.0 / FINE_HZ)
    return COULOMB * np.tanh(rate / SIGN_WIDTH) + VISCOUS * rate + INERTIA * change


def with_both(ratio: float) -> Law:
    """Power of the motor's friction and inertia, shared out as its rate is; else on joint 1."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        torque = friction_and_inertia(dq[:, 0] + ratio * dq[:, 1])
        return np.stack([torque - friction_and_inertia(dq[:, 0]), ratio * torque], axis=1)

    return law


@pytest.mark.parametrize("ratio", RATIOS)
def test_friction_and_inertia_of_the_motor_come_back(ratio: float) -> None:
    scenes = scenes_with(with_both(ratio))
    c, rms = fitted(TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "ratio": ratio})
    assert c == pytest.approx([COULOMB, VISCOUS, INERTIA], rel=0.05)
    assert rms < 0.1
    wrong = fitted(TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "ratio": -ratio})[1]
    assert wrong > 5 * rms


def test_both_neighbours_are_tried() -> None:
    scenes = scenes_with(with_both(1.0), logs=1)
    offered = [
        (j, s["neighbour"])
        for j in (0, 1)
        for s in TransmissionCoupling().grid(scenes, j, [])
        if s["ratio"] == 1.0
    ]
    assert offered == [(0, 1.0), (1, -1.0)]


def test_a_screw_that_slides_and_turns() -> None:
    """Ratios between a slide and a turn are in units of their top speeds."""
    q = wander(20.0, seed=4, rests=()) * np.array([1.0, 0.05])
    scene, effect = scene_of(q, robot=two_joint_robot(prismatic=True)), TransmissionCoupling()
    top = np.max(np.abs(scene.motion.dq), axis=0)
    ratios = [s["ratio"] for s in effect.grid([scene], 1, [])]
    assert max(ratios) == pytest.approx(top[1] / top[0])
    assert max(ratios) < 0.2
    assert 1 / max(ratios) in [pytest.approx(s["ratio"]) for s in effect.grid([scene], 0, [])]


def test_nobody_can_say_what_a_drive_that_sticks_has() -> None:
    """Though both joints move: there is no friction of the one drive that both have."""
    slow = wander(20.0, seed=4, rests=())[:, :1]
    q = np.hstack([slow, -slow])
    middle = len(q) // 2
    q[middle:, 1] *= -1.0
    scene, effect = scene_of(q, robot=two_joint_robot()), TransmissionCoupling()
    guessed = effect.guessed(scene, 1, {"neighbour": -1.0, "ratio": 1.0})
    assert sorted(guessed) == [0, 1]
    assert guessed[0][200 : middle - 200].all()
    assert 0.0 < guessed[1][middle + 200 :].mean() < 0.6
    np.testing.assert_array_equal(guessed[0], guessed[1])
