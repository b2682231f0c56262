"""A motor behind two joints."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.transmission_coupling import TransmissionCoupling
from tests.model.effects.added import scenes_with
from tests.model.effects.fitting import FINE_HZ, Array, Law
from tests.model.effects.measured import fitted, left_over
from tests.model.effects.scenes import SIGN_WIDTH

COULOMB, VISCOUS, INERTIA = 2.1, 0.6, 0.05


def behind_both(sign: float, own: float = 0.0) -> Law:
    """Power of the motor's friction and inertia, shared out as its rate is."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        rate = dq[:, 0] + sign * dq[:, 1]
        change = np.gradient(rate, 1.0 / FINE_HZ)
        torque = COULOMB * np.tanh(rate / SIGN_WIDTH) + VISCOUS * rate + INERTIA * change
        other = own * np.sin(7 * q[:, 1])  # what else the second joint's residual holds
        return np.stack([torque, sign * torque + other], axis=1)

    return law


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_and_inertia_of_the_motor_come_back(sign: float) -> None:
    scenes = scenes_with(behind_both(sign))
    c, rms = fitted(TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "sign": sign})
    assert c == pytest.approx([COULOMB, VISCOUS, INERTIA], rel=0.05)
    assert rms < 0.1
    wrong = fitted(TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "sign": -sign})[1]
    assert wrong > 10 * rms


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_pair_is_named_once_and_where_it_explains_most(sign: float) -> None:
    """The second joint's residual holds other things too."""
    effect = TransmissionCoupling()
    scenes = scenes_with(behind_both(sign, own=3.0))
    residual = [left_over(scene) for scene in scenes]
    offered = [(j, s) for j in (0, 1) for s in effect.grid(scenes, j, residual)]
    right = [(j, s) for j, s in offered if s["sign"] == sign]
    assert right == [(0, {"neighbour": 1.0, "sign": sign})]
    assert len(offered) == 2


def test_both_namings_are_the_same_torque() -> None:
    """Up to the sign, which odd friction does not see."""
    scene = scenes_with(behind_both(1.0), logs=1)[0]
    effect = TransmissionCoupling()
    for sign in (1.0, -1.0):
        here = effect.columns(scene, 0, {"neighbour": 1.0, "sign": sign})
        there = effect.columns(scene, 1, {"neighbour": -1.0, "sign": sign})
        for joint in (0, 1):
            np.testing.assert_allclose(here[joint], there[joint], atol=1e-12)
