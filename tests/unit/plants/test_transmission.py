"""Springs, gaps and couplings between drives and links obey mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants.friction import Frictionless
from tests.plants.hidden import Hidden, Run, Spring
from tests.plants.mechanics import ElasticJoints, RigidJoints, substeps, vibration
from tests.plants.rigid import Rigid
from tests.plants.rigs import one_joint, six_joint
from tests.plants.simulate import Plant, simulate
from tests.plants.torques import State
from tests.plants.trajectories import Reference, fourier, hold
from tests.plants.vertical import vertical_two_joint

Array = NDArray[np.float64]


def swing(seconds: float = 1.5) -> Reference:
    """Both joints of the vertical arm move."""
    rig = vertical_two_joint()
    low, high = 0.8 * rig.position_limits.T
    top, push = 0.8 * rig.velocity_limits, 0.8 * rig.acceleration_limits
    rng = np.random.default_rng(3)
    return fourier(rng, low, high, top, push, seconds=seconds, harmonics=2, rate_hz=1000.0)


def test_stiff_springs_are_a_rigid_arm() -> None:
    """Motion and torque of joints that bend by 0.02 mrad at rated torque."""
    rig, motion = vertical_two_joint(simple_friction=True), swing()
    springs = (Spring(0, 1.5e6, 50.0), Spring(1, 4e5, 20.0))
    stiff = replace(rig, hidden=Hidden(springs=springs))
    plain, bent = (simulate(x, motion, 0, imus=False).truth for x in (rig, stiff))
    late = 0.5e-3 * np.abs(plain.dq).max()  # the encoders are read half a period earlier
    assert np.abs(plain.q - bent.q).max() < late + 2e-4
    assert np.abs(bent.q - bent.angle).max() < 1e-4
    error = np.sqrt(np.mean((plain.tau - bent.tau) ** 2, axis=0))
    assert (error < 0.01 * np.abs(plain.tau).max(axis=0)).all()


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
    at_link = replace(soft, hidden=replace(soft.hidden, link_encoders=True))
    seen = simulate(at_link, hold(start, 0.5, 1000.0), 0, imus=False)
    np.testing.assert_allclose(seen.q, seen.truth.q, atol=rig.encoder_step.max())


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


def test_link_flies_free_inside_its_gap() -> None:
    """Pushed by a constant torque it accelerates by its own inertia; its drive does not move."""
    rig = one_joint()
    arm = replace(rig.arm, gravity=np.zeros(3))
    push, dt, gap = 0.01, 1e-3, 0.02
    hidden = Hidden(springs=(Spring(0, 500.0, 0.02, gap),))
    source = State(0, lambda q, dq: push).begin(Run(0.0, 1.0, dt, 0))
    body = ElasticJoints(Rigid(arm), Frictionless().begin(), (source,), hidden, np.zeros(1), dt)
    rows = [body.step(k * dt, np.zeros(1)) for k in range(200)]
    q = np.array([row.q[0] for row in rows])
    angle = np.array([row.angle[0] for row in rows])
    free = np.abs(q) < 0.49 * gap
    assert free[:100].sum() > 20
    first = int(np.argmin(free))
    t = dt * (np.arange(first) + 0.5)
    wanted = 0.5 * push / arm.phi[0, 9] * t**2
    np.testing.assert_allclose(q[:first], wanted, rtol=0.02, atol=2e-5)
    assert not angle[:first].any()
    assert angle[-1] > 0.0


@pytest.mark.parametrize(
    "spring",
    [
        Spring(0, 1e3, 1.0),
        Spring(0, 1e3, 1.0, gap=0.004),
        Spring(0, 1e3, 1.0, knee=0.003, hard=4e3),
        Spring(0, 1e3, 1.0, gap=0.001, knee=0.003, hard=4e3),
    ],
)
def test_wind_and_torque_are_inverse(spring: Spring) -> None:
    """Static torque of the wind that carries it; teeth never pull."""
    for torque in (-9.0, -1.0, 0.5, 2.9, 3.1, 20.0):
        assert spring.torque(spring.wind_at(torque), 0.0) == pytest.approx(torque)
    if spring.gap > 0:
        assert spring.torque(0.49 * spring.gap, 5.0) == 0.0
        assert spring.torque(0.51 * spring.gap, -50.0) == 0.0


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


def test_coupled_rotors_keep_energy() -> None:
    """Rotors that turn with two joints: kinetic energy 1/2 (A dq)^T J (A dq)."""
    rig = vertical_two_joint()
    arm, dt = rig.arm, 5e-4
    a = np.array([[1.0, 0.0], [0.6, 1.0]])
    links = Rigid(replace(arm, rotor_inertia=np.zeros(2)))
    hidden = Hidden(coupling=a, coupled_rotors=True)
    start = np.array([0.4, 0.8])
    body = RigidJoints(Rigid(arm), Frictionless().begin(), (), hidden, start, dt)
    rows = [body.step(k * dt, np.zeros(2)) for k in range(1000)]
    total = [
        links.energy(row.q, row.dq) + 0.5 * (a @ row.dq) @ (arm.reflected * (a @ row.dq))
        for row in rows[::20]
    ]
    still = np.zeros(2)
    fallen = links.energy(rows[-1].q, still) - links.energy(start, still)
    assert abs(fallen) > 1.0
    assert np.ptp(total) < 1e-3 * abs(fallen)


def test_springs_and_couplings_exclude_each_other() -> None:
    """The combination is refused rather than half done."""
    rig = vertical_two_joint()
    hidden = Hidden(coupling=np.eye(2), springs=(Spring(0, 1e3, 1.0),))
    with pytest.raises(ValueError, match="coupled"):
        simulate(replace(rig, hidden=hidden), hold(np.zeros(2), 0.1, 1000.0), 0, imus=False)
