"""The second simulator: its bodies against closed-form equations and Pinocchio, its time steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plants import twin
from tests.plants.experiments import friction_trials, inertia_trials
from tests.plants.friction import SurfaceFriction
from tests.plants.rigid import Arm, Rigid
from tests.plants.rigs import one_joint, six_joint, two_joint
from tests.plants.simulate import Plant
from tests.plants.trajectories import hold
from tests.studies.coverage_cases import Case, draw

Array = NDArray[np.float64]


def two_links(arm: Arm, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque (2,) N m of two links in a plane, by Lagrange's equations."""
    length = float(arm.dh[1, 1])
    _, ax, ay = arm.phi[0, :3]
    m2, bx, by = arm.phi[1, :3]
    spin = float(arm.gear[1] * arm.rotor_inertia[1]) * arm.rotor_coupling
    one = arm.phi[0, 9] + m2 * length**2 + arm.reflected[0]
    two = arm.phi[1, 9]
    c, s = np.cos(q[1]), np.sin(q[1])
    lever, slope = length * (bx * c - by * s), -length * (bx * s + by * c)
    mass = np.array(
        [
            [one + two + 2 * lever, two + lever + spin],
            [two + lever + spin, two + arm.reflected[1]],
        ]
    )
    coriolis = slope * np.array([2 * dq[0] * dq[1] + dq[1] ** 2, -(dq[0] ** 2)])

    def pull(x: float, y: float, angle: float) -> float:
        """Torque against gravity of a first moment (x, y) kg m turned by `angle`."""
        turned = np.array([-x * np.sin(angle) - y * np.cos(angle), x * np.cos(angle)])
        turned[1] -= y * np.sin(angle)
        return -float(arm.gravity[:2] @ turned)

    outer = pull(bx, by, q[0] + q[1])
    gravity = np.array([pull(ax + m2 * length, ay, q[0]) + outer, outer])
    torque: Array = mass @ ddq + coriolis + gravity
    return torque


@pytest.mark.parametrize("seed", range(8))
def test_planar_arms_follow_lagranges_equations(seed: int) -> None:
    arm = draw(Case("planar", seed, "white", "fine")).plant.arm
    for state in np.random.default_rng(seed).standard_normal((20, 3, 2)):
        assert twin.inverse(arm, *state) == pytest.approx(two_links(arm, *state), rel=1e-12)


@pytest.mark.parametrize("plant", [one_joint(), two_joint(), six_joint()])
@pytest.mark.parametrize("coupled", [False, True])
def test_bodies_are_those_of_pinocchio(plant: Plant, coupled: bool) -> None:
    arm = replace(plant.arm, rotor_coupling=coupled)
    for state in np.random.default_rng(0).standard_normal((20, 3, arm.n)):
        expected = Rigid(arm).inverse(*state)
        assert twin.inverse(arm, *state) == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_rows_satisfy_the_equation_of_motion() -> None:
    """Torque of the motion plus friction is the motor's torque, at every row."""
    drawn = draw(Case("planar", 1, "white", "fine"))
    trial = inertia_trials(drawn.plant, [np.zeros(2)], np.random.default_rng(3), seconds=4.0)[0]
    truth = twin.simulate(drawn.plant, trial.reference, 0, every=4).truth
    rows = range(len(truth.q))
    motion = [twin.inverse(drawn.plant.arm, truth.q[k], truth.dq[k], truth.ddq[k]) for k in rows]
    left = truth.tau - truth.friction - np.array(motion)
    size = np.sqrt(np.mean(truth.tau**2, axis=0))
    assert (np.sqrt(np.mean(left**2, axis=0)) < 5e-4 * size).all()


def test_a_sliding_joint_feels_the_law_and_one_at_rest_is_held() -> None:
    drawn = draw(Case("one", 2, "white", "fine"))
    plant = drawn.plant
    assert isinstance(plant.friction, SurfaceFriction)
    trial = friction_trials(plant, [np.zeros(1)], speeds=3)[0]
    truth = twin.simulate(plant, trial.reference, 0).truth
    law = plant.friction.begin()(0.0, truth.q, truth.dq, truth.q)
    dry = np.where(truth.dq > 0, law.forward, -law.backward)
    fast = np.abs(truth.dq[:, 0]) > 0.05
    off = np.abs(truth.friction - dry - law.smooth)[fast]
    assert np.median(off) < 1e-4 * plant.friction.coulomb[0]
    still = twin.simulate(plant, hold(np.zeros(1), 1.0, 1000.0), 0).truth
    assert np.ptp(still.q) == 0.0


def test_energy_without_friction_or_control_is_kept() -> None:
    """Half a second of free swing changes the energy by a millionth of what moves."""
    base = two_joint()
    none = np.zeros(2)
    plant = replace(
        base,
        arm=replace(base.arm, gravity=np.array([3.0, 0.0, -9.0])),
        nominal=replace(base.nominal, phi=0 * base.nominal.phi, rotor_inertia=none),
        friction=replace(base.friction, coulomb=none, viscous=none, stribeck=none),
        gains=replace(base.gains, stiffness=none, damping=none),
        coulomb_guess=none,
    )
    start = np.array([1.4, -0.3])
    truth = twin.simulate(plant, hold(start, 0.5, 1000.0), 0).truth
    rigid = Rigid(plant.arm)
    energy = [rigid.energy(q, dq) for q, dq in zip(truth.q, truth.dq, strict=True)]
    kinetic = 0.5 * truth.dq[-1] @ rigid.terms(truth.q[-1], truth.dq[-1])[0] @ truth.dq[-1]
    assert kinetic > 0.05
    assert np.ptp(energy) < 1e-5 * kinetic
