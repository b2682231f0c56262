"""Every undeclared effect does what its size says, to the joint that it is put into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from tests.plants.arms.rated import rated_torque, tool_point
from tests.plants.arms.rigs import six_joint
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.effects.registry import REGISTRY, inject
from tests.plants.friction.surface import Friction
from tests.plants.mechanics.drives import Lag, Skew
from tests.plants.mechanics.hidden import Hidden, Run, Spring
from tests.plants.mechanics.rigid import build_model
from tests.plants.mechanics.torques import Contact, Counterbalance
from tests.plants.motions.trajectories import Reference, periodic
from tests.plants.robotfile import robot_toml
from tests.plants.simulate import Plant, simulate

Array = NDArray[np.float64]
RUN = Run(100.0, 2.0, 1e-3, 5)
STIFF = Hidden(springs=(Spring(1, 1e6, 30.0),))
PAIR = "transmission_coupling"
SMOOTH = (  # name, share of the top speed, share of rated torque there
    ("stribeck", 0.0, 0.05),
    ("quadratic_drag", 0.8, 0.05),
    ("nonlinear_viscous", 0.8, 0.05),
    ("nonlinear_viscous.root", 0.4, 0.05),
)


def rig() -> Plant:
    """The arm without noise and with Coulomb and viscous friction."""
    plant = vertical_two_joint(simple_friction=True)
    return replace(plant, current_noise=np.zeros(2), current_step=0.0)


@pytest.fixture(scope="module")
def motion() -> Reference:
    """Both joints of the vertical arm, 3 s."""
    plant = rig()
    low, high = 0.9 * plant.position_limits.T
    top, push = 0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits
    rng = np.random.default_rng(3)
    return periodic(
        rng, low, high, top, push, period=2.0, periods=1, harmonics=2, rate_hz=1000.0, fade=0.5
    )


@pytest.fixture(scope="module")
def plain(motion: Reference) -> Array:
    """Logged torque of the clean arm, (N, n) N m."""
    return torque_of(rig(), motion)


@pytest.fixture(scope="module")
def stiff(motion: Reference) -> Array:
    """The same with a spring that hardly bends: what elastic joints are compared with."""
    return torque_of(replace(rig(), hidden=STIFF), motion)


def torque_of(plant: Plant, motion: Reference) -> Array:
    """Logged torque, (N, n) N m."""
    return simulate(plant, motion, 0, imus=False, start=600.0).current * plant.torque_per_ampere


def friction_at(plant: Plant, joint: int, speed: float, load: float = 0.0) -> Friction:
    """Friction of one joint in the middle of its range, after a step at that speed."""
    q, dq, loads = plant.position_limits.mean(axis=1), np.zeros(2), np.zeros(2)
    dq[joint], loads[joint] = speed, load
    dry = plant.friction.begin()(0.0, q, dq, loads)
    return Friction(*(x[joint] for x in dry))


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_effect_shows_where_it_is(name: str, motion: Reference, plain: Array, stiff: Array) -> None:
    """It changes the log, its own joint's most, and leaves the robot file as it was."""
    plant = rig()
    found = inject(name, plant, 1)
    change = torque_of(found.plant, motion) - (stiff if found.plant.hidden.springs else plain)
    share = np.sqrt(np.mean(change**2, axis=0)) / rated_torque(plant)
    assert share[1] > (0.0003 if name == "backlash" else 0.002)
    assert share.max() < 0.15
    assert found.joint in (None, 1)
    if found.joint == 1 and not found.plant.hidden.springs:
        assert share[1] > (1.0 if found.kind == PAIR else 2.0) * share[0]
    assert robot_toml("arm", found.declared) == robot_toml("arm", plant)


@pytest.mark.parametrize(("name", "share", "promised"), SMOOTH)
def test_friction_is_as_large_as_promised(name: str, share: float, promised: float) -> None:
    """What the curve adds to the clean friction, at sizes 1 and 0.4."""
    plant = rig()
    speed = share * float(plant.velocity_limits[1]) + 1e-9
    before = friction_at(plant, 1, speed)
    for size in (1.0, 0.4):
        after = friction_at(inject(name, plant, 1, size).plant, 1, speed)
        more = after.forward - before.forward + after.smooth - before.smooth
        assert more == pytest.approx(promised * size * rated_torque(plant)[1], rel=1e-4)


def test_gears_lose_more_when_driving() -> None:
    """Forward against a load it drives, backward it is driven; mirrored for the other sign."""
    plant = rig()
    lossy = inject("gear_efficiency", plant, 1).plant
    level = friction_at(plant, 1, 1.0).forward
    for load in (4.0, -4.0):
        dry = friction_at(lossy, 1, 1.0, load)
        driving, driven = (dry.forward, dry.backward)[:: int(np.sign(load))]
        assert driving - level == pytest.approx(0.15 * 4.0)
        assert driven - level == pytest.approx(0.03 * 4.0)
    both = friction_at(inject("load_dependent_friction", plant, 1).plant, 1, 1.0, -4.0)
    assert both.forward == both.backward == pytest.approx(level + 0.4)


def test_lag_and_skew_delay_by_their_times() -> None:
    """A ramp is late by the lag; a skewed reading is the true one of before."""
    stage = Lag(np.array([0.004])).begin(RUN)
    ramp = [stage(0.0, np.array([float(k)]), np.zeros(1))[0] for k in range(200)]
    assert 199.0 - ramp[-1] == pytest.approx(4.0, abs=1e-6)
    t = np.arange(1000, dtype=np.float64) / 1000.0
    wave = np.asarray(np.sin(np.outer(t, [5.0, 9.0])), dtype=np.float64)
    late = Skew(np.array([0.004, -0.0025])).read(t, wave, RUN)
    wanted = np.column_stack([np.sin(5.0 * (t - 0.004)), np.sin(9.0 * (t + 0.0025))])
    np.testing.assert_allclose(late[10:-10], wanted[10:-10], atol=2e-5)


@pytest.mark.parametrize("plant", [vertical_two_joint(), six_joint()], ids=["two", "six"])
def test_push_does_the_work_of_its_force(plant: Plant) -> None:
    """J^T F times a small joint move is F times the point's move."""
    point, n = tool_point(plant), plant.arm.n
    contact = Contact(plant.arm, point, 10.0)
    model = build_model(plant.arm)
    data = model.createData()
    rng = np.random.default_rng(2)
    for _ in range(10):
        q, way = rng.uniform(-1, 1, (2, n))
        force = rng.standard_normal(3)
        places = []
        for step in (-1e-6, 1e-6):
            pin.forwardKinematics(model, data, q + step * way)
            places.append(data.oMi[n].act(point))
        moved = (places[1] - places[0]) / 2e-6
        torque = contact.torque(model, data, q, force)
        assert torque @ way == pytest.approx(force @ moved, abs=1e-7)


def test_a_counterbalance_is_conservative_and_sized() -> None:
    """Its torque is the slope of the energy of its spring, at most four times what is clear."""
    plant = rig()
    law = inject("spring.counterbalance", plant, 1).plant.hidden.torques[-1]
    assert isinstance(law, Counterbalance)
    q = np.linspace(*plant.position_limits[1], 2001)
    torque = np.array([law.torque(float(x)) for x in q])
    angle = q - law.zero
    length = np.sqrt(1.0 + law.arm**2 - 2.0 * law.arm * np.cos(angle))
    energy = 0.5 * law.stiffness * np.maximum(length - law.slack, 0.0) ** 2
    np.testing.assert_allclose(torque, -np.gradient(energy, q), atol=0.01 * np.abs(torque).max())
    assert np.abs(torque).max() == pytest.approx(0.2 * rated_torque(plant)[1], rel=1e-3)
