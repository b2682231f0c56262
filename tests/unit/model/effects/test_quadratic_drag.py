"""Drag with the square of the speed."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.quadratic_drag import QuadraticDrag
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.model.effects.fitting import Array, direction, fit, trial
from tests.unit.model.effects.scenes import scene_of, wander

DRAG = 0.25  # N m s^2/rad^2


def law(t: Array, q: Array, dq: Array) -> Array:
    """A body in a fluid: power lost grows with the cube of the speed."""
    lost = DRAG * np.abs(dq) ** 3
    at_rest = dq == 0.0
    return np.where(at_rest, 0.0, lost / np.where(at_rest, 1.0, dq)) + direction(dq) + 0.5 * dq


@pytest.mark.parametrize("joint", [0, 1])
def test_the_drag_coefficient_comes_back(joint: int) -> None:
    trials = [trial(law, seed=k, noise=0.05) for k in range(2)]
    found = fit(QuadraticDrag(), trials, joint)
    assert found.c[0] == pytest.approx(DRAG, rel=0.03)
    assert found.left < 0.05


def test_of_a_slide_it_is_a_force() -> None:
    slide = two_joint_robot(prismatic=True)
    units = [QuadraticDrag().values(slide, j, {}, np.ones(1), np.eye(1))[0].unit for j in (0, 1)]
    assert units == ["N m s^2/rad^2", "N s^2/m^2"]


def test_odd_in_the_velocity() -> None:
    q = wander(8.0)
    there, back = (QuadraticDrag().columns(scene_of(p), 0, {})[0] for p in (q, -q))
    np.testing.assert_allclose(there, -back, atol=1e-12)
