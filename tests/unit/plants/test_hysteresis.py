"""Bristles, cables and warm gears: steady states, loops and balances."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.effects.friction import heat_of
from tests.plants.friction.hysteresis import Bristles
from tests.plants.mechanics.hidden import Run

Array = NDArray[np.float64]
RUN = Run(0.0, 10.0, 1e-3, 0)


def torques(law: object, path: Array, dt: float = 1e-3) -> Array:
    """Friction torque of joint 0 along a path (N,) rad."""
    assert callable(law)
    rates = np.gradient(path, dt)
    zero = np.zeros(2)
    out = np.empty_like(path)
    for k, (q, v) in enumerate(zip(path, rates, strict=True)):
        dry = law(k * dt, np.array([q, 0.0]), np.array([v, 0.0]), zero)
        assert dry.forward[0] == dry.backward[0] == 0.0
        out[k] = dry.smooth[0]
    return out


@pytest.mark.parametrize("speed", [0.05, -0.4])
def test_bristles_slip_at_the_friction_they_replace(speed: float) -> None:
    """After a few slip lengths at constant speed: Coulomb plus viscous."""
    base = vertical_two_joint().friction
    law = Bristles(base, 0, 200.0, 3.0).begin()
    path = np.asarray(speed * np.arange(4000) * 1e-3, dtype=np.float64)
    q, dq = np.array([path[-1], 0.0]), np.array([speed, 0.0])
    dry = base.begin()(0.0, q, dq, np.zeros(2))
    wanted = np.sign(speed) * dry.forward[0] + dry.smooth[0]
    assert torques(law, path)[-1] == pytest.approx(wanted, rel=1e-3)


def test_bristles_only_take_energy() -> None:
    """Work around closed loops of every amplitude is positive."""
    base = vertical_two_joint(simple_friction=True).friction
    for amplitude in (1e-4, 2e-3, 5e-2):
        path = amplitude * np.sin(2.0 * np.pi * np.arange(6000) / 2000.0)
        force = torques(Bristles(base, 0, 500.0).begin(), path)
        loop = slice(2000, 6001)
        assert np.trapezoid(force[loop], path[loop]) > 0.0


def test_heat_flows_until_loss_is_power() -> None:
    """Steady state, one time constant, and the same by steps."""
    heat = heat_of(vertical_two_joint(simple_friction=True))
    power, dt = np.tile([4.0, 1.0], (40000, 1)), 0.1
    degrees = heat.trace(0.0, power, dt)
    np.testing.assert_allclose(degrees[0], heat.ambient)
    np.testing.assert_allclose(degrees[-1], heat.ambient + power[0] / heat.loss, rtol=1e-4)
    np.testing.assert_allclose(
        degrees[3000], heat.ambient + power[0] / heat.loss * (1 - np.exp(-1.0)), rtol=1e-6
    )
    stepped = heat.at(0.0)
    for row in power[:50]:
        stepped = heat.advance(stepped, row, dt)
    np.testing.assert_allclose(degrees[50], stepped)
    np.testing.assert_allclose(heat.trace(500.0, power, dt)[0], heat.at(500.0))
