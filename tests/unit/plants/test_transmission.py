"""Springs, gaps and couplings between drives and links obey mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.arms.rigs import one_joint, six_joint
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.friction.surface import Frictionless
from tests.plants.mechanics.hidden import Hidden, Spring
from tests.plants.mechanics.joints import ElasticJoints, substeps, vibration
from tests.plants.mechanics.rigid import Rigid
from tests.plants.motions.trajectories import Reference, fourier, hold
from tests.plants.simulate import Plant, simulate

Array = NDArray[np.float64]


def swing(seconds: float = 1.5) -> Reference:
    """Both joints of the vertical arm move."""
    rig = vertical_two_joint()
    low, high = 0.8 * rig.position_limits.T
    top, push = 0.8 * rig.velocity_limits, 0.8 * rig.acceleration_limits
    rng = np.random.default_rng(3)
    return fourier(rng, low, high, top, push, seconds=seconds, harmonics=2, rate_hz=1000.0)


def test_elastic_arm_rests_on_its_springs() -> None:
    """At rest the wind is gravity over stiffness, and the encoder says where it should be."""
    rig = vertical_two_joint(simple_friction=True)
    soft = replace(rig, hidden=Hidden(springs=(Spring(0, 1500.0, 5.0),)))
    start = np.array([0.3, -0.5])
    log = simulate(soft, hold(start, 0.5, 1000.0), 0, imus=False)
    truth = log.truth
    wind = truth.angle[-1] - truth.q[-1]
    gravity = Rigid(rig.arm).gravity_torque(truth.q[-1])
    assert wind[0] == pytest.approx(gravity[0] / 1500.0, rel=1e-3)
    assert wind[1] == 0.0
    assert np.abs(log.q - start).max() < 1e-3


@pytest.mark.parametrize("rig", [vertical_two_joint(), six_joint()], ids=["two", "six"])
def test_energy_stays_in_links_drives_and_springs(rig: Plant) -> None:
    """An arm without friction falls on an undamped spring."""
    arm = rig.arm
    joint, start = arm.n - 1, np.linspace(0.5, 1.0, arm.n)
    spring, dt = Spring(joint, 300.0, 0.0), 5e-4
    rigid = Rigid(arm)
    shed = np.zeros(arm.n)
    shed[joint] = arm.rotor_inertia[joint]
    links = Rigid(replace(arm, rotor_inertia=arm.rotor_inertia - shed))
    body = ElasticJoints(rigid, Frictionless().begin(), (), Hidden(springs=(spring,)), start, dt)
    total, wound, before = [], [], None
    for k in range(800):
        row = body.step(k * dt, np.zeros(arm.n))
        wind = float(row.angle[joint] - row.q[joint])
        if before is not None:
            rate = (float(row.angle[joint]) - before) / dt
            energy = links.energy(row.q, row.dq) + 0.5 * 300.0 * wind**2
            total.append(energy + 0.5 * float(arm.reflected[joint]) * rate**2)
            wound.append(wind)
        before = float(row.angle[joint])
    fallen = rigid.energy(row.q, np.zeros(arm.n)) - rigid.energy(start, np.zeros(arm.n))
    assert abs(fallen) > 1.0
    assert np.ptp(wound) > 1e-4
    assert np.ptp(total) < 0.02 * abs(fallen)


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
