"""Drag and its relatives, told apart by the exponent."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.nonlinear_viscous import NonlinearViscous
from tests.unit.model.effects.fitting import Array, Law, direction, fit, trial


def power_law(size: float, exponent: float) -> Law:
    """Coulomb, viscous and one more power of the speed."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        speed = np.abs(dq)
        return direction(dq) * (2.0 + 0.5 * speed + size * speed**exponent)

    return law


@pytest.mark.parametrize(("size", "exponent"), [(2.0, 0.5), (1.5, 0.7), (0.4, 3.0), (-0.1, 3.0)])
def test_exponents_come_back(size: float, exponent: float) -> None:
    trials = [trial(power_law(size, exponent), seed=k, noise=0.05) for k in range(3)]
    found = fit(NonlinearViscous(), trials, joint=0)
    assert found.settings["exponent"] == pytest.approx(exponent, rel=0.1)
    assert found.c[0] == pytest.approx(size, rel=0.25)
    assert found.left < 0.05


def test_drag_is_not_called_nonlinear_viscous() -> None:
    effect = NonlinearViscous()
    trials = [trial(power_law(0.3, 2.0), seed=k, noise=0.05) for k in range(2)]
    found = fit(effect, trials, joint=0)
    assert found.settings["exponent"] == pytest.approx(2.0, abs=0.1)
    assert not effect.plausible([t.scene for t in trials], 0, found.settings, found.c)
