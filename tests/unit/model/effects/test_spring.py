"""A spring beside gravity."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.spring import Spring
from tests.unit.model.effects.added import scenes_with
from tests.unit.model.effects.fitting import Array
from tests.unit.model.effects.measured import best_fitted, fitted

K, REST, CUBIC = 12.0, 0.3, 4.0  # N m/rad, rad, N m/rad^3


def pull(t: Array, q: Array, dq: Array) -> Array:
    """Energy K (q - REST)^2 / 2 of the second joint, differentiated numerically."""
    energy = 0.5 * K * (q + np.array([[[-1e-4]], [[1e-4]]]) - REST) ** 2
    slope: Array = np.diff(energy, axis=0)[0] / 2e-4 * np.array([0.0, 1.0])
    return slope


@pytest.mark.parametrize("cubic", [0.0, 1.0])
def test_stiffness_and_rest_come_back(cubic: float) -> None:
    scenes = scenes_with(pull)
    c, rms = fitted(Spring(), scenes, 1, {"cubic": cubic})
    values = Spring().values(scenes[0].robot, 1, {"cubic": cubic}, c, 1e-4 * np.eye(len(c)))
    assert values[0].value == pytest.approx(K, rel=0.01)
    assert values[1].value == pytest.approx(REST, abs=0.01)
    assert values[1].std_error == pytest.approx(1e-2 / K * np.hypot(1.0, REST), rel=0.05)
    assert rms < 0.05


def test_a_stiffening_cable_needs_the_cube() -> None:
    scenes = scenes_with(lambda t, q, dq: (K * q + CUBIC * q**3) * np.array([1.0, 0.0]))
    settings, c, _ = best_fitted(Spring(), scenes, 0)
    assert settings == {"cubic": 1.0}
    assert c[0] == pytest.approx(K, rel=0.02)
    assert c[2] == pytest.approx(CUBIC, rel=0.03)
    assert c[3] == pytest.approx(0.0, abs=0.1)


def between_two_points(t: Array, q: Array, dq: Array) -> Array:
    """Energy of a coil spring from a point 0.3 m off the axis to one 0.25 m off it on the link."""
    angle = q + 0.5 + np.array([[[-1e-4]], [[1e-4]]])
    length = np.sqrt(0.3**2 + 0.25**2 - 2 * 0.3 * 0.25 * np.cos(angle))
    energy = 0.5 * 1500.0 * (length - 0.03) ** 2
    slope: Array = np.diff(energy, axis=0)[0] / 2e-4 * np.array([1.0, 0.0])
    return slope


def test_a_spring_between_two_points_pulls_otherwise_on_either_side() -> None:
    scenes = scenes_with(between_two_points)
    settings, c, rms = best_fitted(Spring(), scenes, 0)
    _, linear = fitted(Spring(), scenes, 0, {"cubic": 0.0})
    assert settings == {"cubic": 1.0}
    assert abs(c[3]) > 5.0
    assert rms < 0.3 * linear
