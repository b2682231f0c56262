"""Bristles, cables and warm gears: steady states, loops and balances."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.heat import WarmingFriction
from tests.plants.hidden import Run
from tests.plants.hysteresis import Bristles, Cable, slip
from tests.plants.injections_friction import heat_of, presliding, thermal
from tests.plants.rated import rated_torque
from tests.plants.simulate import simulate
from tests.plants.trajectories import hold
from tests.plants.vertical import vertical_two_joint

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


def test_bristles_depend_on_the_way_not_on_the_time() -> None:
    """A move in one step or in many bends them alike; small moves are springs."""
    way = slip(slip(0.3e-3, 1e-3, 2e-3), 0.5e-3, 2e-3)
    assert way == pytest.approx(slip(0.3e-3, 1.5e-3, 2e-3), rel=1e-12)
    assert slip(0.0, 1e-7, 2e-3) == pytest.approx(1e-7, rel=1e-4)
    assert slip(0.0, -1.0, 2e-3) == pytest.approx(-2e-3)


def test_bristles_only_take_energy() -> None:
    """Work around closed loops of every amplitude is positive."""
    base = vertical_two_joint(simple_friction=True).friction
    for amplitude in (1e-4, 2e-3, 5e-2):
        path = amplitude * np.sin(2.0 * np.pi * np.arange(6000) / 2000.0)
        force = torques(Bristles(base, 0, 500.0).begin(), path)
        loop = slice(2000, 6001)
        assert np.trapezoid(force[loop], path[loop]) > 0.0


def test_presliding_joint_rests_and_follows() -> None:
    """An arm on bristles holds its posture within their bend."""
    rig = presliding(vertical_two_joint(simple_friction=True), 0, 1.0)
    log = simulate(rig, hold(np.array([0.4, 0.3]), 1.5, 1000.0), 0, imus=False)
    assert np.abs(log.truth.q - [0.4, 0.3]).max() < 0.02
    assert np.abs(log.truth.dq[-200:]).max() < 1e-2


def test_cable_loop_is_that_of_maxwell_slip() -> None:
    """Area 4 level (amplitude - reach), no loss inside the reach."""
    cable = Cable(0, 2.0, 0.1, 0.6, 0.15)
    for amplitude, area in ((1.0, 4 * 0.6 * 0.85), (0.1, 0.0)):
        source = cable.begin(RUN)
        path = amplitude * np.sin(2.0 * np.pi * np.arange(12001) / 4000.0)
        force = np.array([source(0.0, np.array([q]), np.zeros(1))[0] for q in path])
        loop = slice(4000, 8001)
        work = -np.trapezoid(force[loop], path[loop])
        assert work == pytest.approx(area, rel=1e-3, abs=1e-6)


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


def test_heating_power_of_a_log_balances() -> None:
    """C dT = (P - G (T - ambient)) dt over a log, within the step."""
    heat = heat_of(vertical_two_joint(simple_friction=True))
    power = np.abs(np.random.default_rng(0).standard_normal((5000, 2)))
    degrees = heat.trace(60.0, power, 1e-3)
    stored = heat.capacity * (degrees[-1] - degrees[0])
    lost = heat.loss * (degrees[:-1] - heat.ambient).sum(axis=0) * 1e-3
    np.testing.assert_allclose(stored, power[:-1].sum(axis=0) * 1e-3 - lost, rtol=1e-3)


def test_warm_gears_turn_more_easily_by_what_was_promised() -> None:
    """After hours of usual work: a clear torque less at the top speed."""
    rig = vertical_two_joint(simple_friction=True)
    warm = thermal(rig, 1, 1.0)
    assert isinstance(warm.friction, WarmingFriction)
    top, zero = rig.velocity_limits, np.zeros(2)
    cold, hot = (warm.friction.begin()(t, zero, top, zero).smooth for t in (0.0, 1e5))
    assert cold[1] - hot[1] == pytest.approx(0.05 * rated_torque(rig)[1], rel=1e-6)
    assert cold[0] == hot[0]


def test_logs_carry_temperatures_that_rise_with_the_start() -> None:
    """0.1 K steps, warmer later, none without a heat balance."""
    rig = vertical_two_joint(simple_friction=True)
    still = hold(np.zeros(2), 0.2, 1000.0)
    early, late = (
        simulate(thermal(rig, 0, 1.0), still, 0, imus=False, start=s).temperature
        for s in (0.0, 900.0)
    )
    assert early is not None
    assert late is not None
    assert early.shape == (200, 2)
    assert (late.mean(axis=0) - early.mean(axis=0) > 15.0).all()
    np.testing.assert_allclose(np.round(early * 10.0), early * 10.0, atol=1e-9)
    assert simulate(rig, still, 0, imus=False).temperature is None
