"""The hump comes back, whatever its exponent, from exact stick and slip."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.stribeck import Stribeck
from tests.unit.model.effects.fitting import Array, direction, fit, trial
from tests.unit.model.effects.scenes import scene_of, wander

HEIGHT, SPEED = 2.0, 0.12  # N m, rad/s


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_parameters_come_back(exponent: float) -> None:
    """Friction as Armstrong-Helouvry writes it: one curve of the speed."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        low, high = 3.0, 3.0 + HEIGHT
        level = low + (high - low) * np.exp(-((np.abs(dq) / SPEED) ** exponent))
        return level * direction(dq) + 0.7 * dq

    found = fit(Stribeck(), [trial(law, seed=k, noise=0.2) for k in range(3)], joint=0)
    assert found.settings["exponent"] == exponent
    assert found.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    assert found.c[0] == pytest.approx(HEIGHT, rel=0.06)
    assert found.left < 0.1


def test_a_hump_wider_than_the_motion_is_not_believed() -> None:
    effect, scene = Stribeck(), scene_of(wander(10.0))
    inside = {"stribeck_speed": 0.1, "exponent": 2.0}
    beyond = {"stribeck_speed": 50.0, "exponent": 2.0}
    assert effect.plausible([scene], 0, inside, np.array([1.0]))
    assert not effect.plausible([scene], 0, inside, np.array([-1.0]))
    assert not effect.plausible([scene], 0, beyond, np.array([1.0]))
