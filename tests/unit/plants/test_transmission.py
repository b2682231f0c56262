"""Springs, gaps and couplings between drives and links obey mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.arms.rigs import one_joint
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.friction.surface import Frictionless
from tests.plants.mechanics.hidden import Hidden, Spring
from tests.plants.mechanics.joints import ElasticJoints, substeps, vibration
from tests.plants.mechanics.rigid import Rigid
from tests.plants.motions.trajectories import Reference, fourier
from tests.plants.simulate import simulate

Array = NDArray[np.float64]


def swing(seconds: float = 1.5) -> Reference:
    """Both joints of the vertical arm move."""
    rig = vertical_two_joint()
    low, high = 0.8 * rig.position_limits.T
    top, push = 0.8 * rig.velocity_limits, 0.8 * rig.acceleration_limits
    rng = np.random.default_rng(3)
    return fourier(rng, low, high, top, push, seconds=seconds, harmonics=2, rate_hz=1000.0)


def test_two_masses_swing_at_their_own_frequency() -> None:
    """A kicked link against its drive: zero crossings of the wind."""
    rig = one_joint()
    arm = replace(rig.arm, gravity=np.zeros(3))
    spring, start, dt = Spring(0, 2.0, 0.0), np.zeros(1), 1e-3
    rate = vibration(Rigid(arm), spring, start)
    inertia, reflected = arm.phi[0, 9], arm.reflected[0]
    assert rate == pytest.approx(np.sqrt(2.0 * (1.0 / inertia + 1.0 / reflected)))
    hidden = Hidden(springs=(spring,))
    parts = substeps(Rigid(arm), hidden, start, dt)
    assert rate * dt / parts <= 0.5

    def kick(t: float, q: Array, dq: Array) -> Array:
        return np.array([0.01 if t < 0.005 else 0.0])

    body = ElasticJoints(Rigid(arm), Frictionless().begin(), (kick,), hidden, start, dt)
    rows = [body.step(k * dt, np.zeros(1)) for k in range(1500)]
    wind = np.array([row.angle[0] - row.q[0] for row in rows])[10:]
    ups = np.flatnonzero((wind[:-1] < 0) & (wind[1:] >= 0))
    found = 2.0 * np.pi * (len(ups) - 1) / (float(ups[-1] - ups[0]) * dt)
    assert found == pytest.approx(rate, rel=0.02)


def test_coupled_friction_maps_back_with_the_transpose() -> None:
    """At the joints: A^T f(A dq); an identity couples nothing."""
    rig, motion = vertical_two_joint(simple_friction=True), swing(1.0)
    a = np.array([[1.0, 0.0], [0.4, 1.0]])
    truth = simulate(replace(rig, hidden=Hidden(coupling=a)), motion, 0, imus=False).truth
    rates = truth.dq @ a.T
    moving = (np.abs(rates) > 0.05).all(axis=1)
    law = rig.friction.begin()
    dry = law(0.0, truth.q, rates, np.zeros(2))
    drive = np.sign(rates) * dry.forward + dry.smooth
    np.testing.assert_allclose(truth.friction[moving], (drive @ a)[moving], rtol=0.02, atol=0.01)
    same = simulate(replace(rig, hidden=Hidden(coupling=np.eye(2))), motion, 0, imus=False).truth
    plain = simulate(rig, motion, 0, imus=False).truth
    np.testing.assert_allclose(same.q, plain.q, atol=1e-9)
