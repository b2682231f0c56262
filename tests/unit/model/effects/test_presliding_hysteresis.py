"""The closed form is Dahl's differential equation, and its distance comes back."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.presliding_hysteresis import PreslidingHysteresis, deflection
from tests.unit.model.effects.fitting import Array, fit, trial
from tests.unit.model.effects.scenes import scene_of, wander

TORQUE, DISTANCE = 5.0, 0.01  # N m, rad
POINT = {"presliding_distance": DISTANCE}


def dahl(q: Array, distance: float, substeps: int = 20) -> Array:
    """Integrate z' = v - |v| z / z_max by the midpoint rule, the speed constant in each sample."""
    z, out = 0.0, np.zeros(len(q))
    for k, way in enumerate(np.diff(q) / substeps):
        for _ in range(substeps):
            half = z + 0.5 * (way - abs(way) * z / distance)
            z += way - abs(way) * half / distance
        out[k + 1] = z / distance
    return out


def law(t: Array, q: Array, dq: Array) -> Array:
    """Dahl friction and viscous friction on both joints."""
    bristles = [TORQUE * dahl(q[:, j], DISTANCE, substeps=2) for j in range(q.shape[1])]
    return np.stack(bristles, axis=1) + 0.5 * dq


@pytest.mark.parametrize("distance", [0.003, 0.03, 0.3])
def test_the_closed_form_solves_the_differential_equation(distance: float) -> None:
    q = wander(15.0, seed=4)[:, 0]
    np.testing.assert_allclose(deflection(q, distance), dahl(q, distance), atol=1e-3)


def test_parameters_come_back() -> None:
    found = fit(PreslidingHysteresis(), [trial(law, seed=k, noise=0.2) for k in range(3)], joint=1)
    assert found.settings["presliding_distance"] == pytest.approx(DISTANCE, rel=0.03)
    assert found.c[0] == pytest.approx(TORQUE, rel=0.03)
    assert found.left < 0.05


def test_a_distance_that_the_motion_does_not_cover_is_not_believed() -> None:
    effect, scene = PreslidingHysteresis(), scene_of(wander(10.0, amplitude=0.1))
    assert effect.plausible([scene], 0, POINT, np.ones(1))
    assert not effect.plausible([scene], 0, POINT, -np.ones(1))
    assert not effect.plausible([scene], 0, {"presliding_distance": 0.3}, np.ones(1))
