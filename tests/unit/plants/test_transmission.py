"""Springs, gaps and couplings between drives and links obey mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.arms.rigs import one_joint
from tests.plants.friction.surface import Frictionless
from tests.plants.mechanics.hidden import Hidden, Spring
from tests.plants.mechanics.joints import ElasticJoints, substeps, vibration
from tests.plants.mechanics.rigid import Rigid

Array = NDArray[np.float64]


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
