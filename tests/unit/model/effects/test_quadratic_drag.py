"""Drag with the square of the speed."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.quadratic_drag import QuadraticDrag
from tests.unit.model.effects.fitting import Array, direction, fit, trial

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
