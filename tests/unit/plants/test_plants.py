"""The simulated robots obey mechanics, and their instruments read what they should."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.plants.arms.rigs import one_joint, six_joint, two_joint
from tests.plants.friction.surface import Friction, Frictionless, stick_slip
from tests.plants.mechanics.rigid import Rigid, build_model, link_motion
from tests.plants.motions.experiments import validation_trials
from tests.plants.motions.trajectories import hold
from tests.plants.simulate import Plant, simulate

PLANTS: dict[str, Callable[..., Plant]] = {
    "one_joint": one_joint,
    "two_joint": two_joint,
    "six_joint": six_joint,
}


@pytest.fixture(params=sorted(PLANTS))
def plant(request: pytest.FixtureRequest) -> Plant:
    return PLANTS[str(request.param)]()


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("name", ["one_joint", "six_joint"])
def test_energy_is_conserved_without_friction_and_control(
    name: str, coupled: bool
) -> None:
    """Kinetic plus potential energy stays while the arm falls and turns potential into
    kinetic.
    """
    rig = PLANTS[name]()
    arm, still = replace(rig.arm, rotor_coupling=coupled), np.zeros(rig.arm.n)
    loose = replace(
        rig,
        arm=arm,
        friction=Frictionless(),
        gains=replace(rig.gains, stiffness=still, damping=still),
        coulomb_guess=still,
        nominal=replace(arm, phi=np.zeros_like(arm.phi) + 1e-12, rotor_inertia=still),
    )
    start = hold(np.linspace(0.5, 1.0, arm.n), 0.8, 2000.0)
    truth, rigid = simulate(loose, start, 0, imus=False).truth, Rigid(arm)
    rows = zip(truth.q[::50], truth.dq[::50], strict=True)
    total = np.array([rigid.energy(q, dq) for q, dq in rows])
    moved = abs(rigid.energy(truth.q[-1], still) - rigid.energy(truth.q[0], still))
    assert moved > 0.002
    assert np.abs(total - total[0]).max() < 2e-4 * moved


def test_accelerometers_match_differentiated_positions(plant: Plant) -> None:
    """Specific force is the second derivative of the sensor's place, minus gravity."""
    step, t0 = 1e-4, 0.7
    t = t0 + step * np.arange(-2, 3)
    swing = np.linspace(0.4, 0.9, plant.arm.n)
    pace = np.linspace(2.0, 3.5, plant.arm.n)
    q = swing * np.sin(np.outer(t, pace))
    dq, ddq = swing * pace * np.cos(pace * t0), -swing * pace**2 * np.sin(pace * t0)
    model = build_model(plant.arm)
    data = model.createData()
    for imu in plant.imus:
        points = imu.lever + imu.positions @ imu.rotation.T
        places = []
        for row in q:
            pin.forwardKinematics(model, data, row)
            places.append([data.oMi[imu.after + 1].act(p) for p in points])
            if len(places) == 3:
                turn = data.oMi[imu.after + 1].rotation.copy()
        x = np.array(places)
        second = (-x[0] + 16 * x[1] - 30 * x[2] + 16 * x[3] - x[4]) / (12 * step**2)
        wanted = np.einsum(
            "kj,kj->k", second - plant.arm.gravity, imu.axes @ (turn @ imu.rotation).T
        )
        motion = link_motion(plant.arm, imu.after, q[2][None], dq[None], ddq[None])
        np.testing.assert_allclose(imu.ideal(motion)[0], wanted, atol=2e-5)


def test_torque_balance_is_rnea_on_the_true_motion(plant: Plant) -> None:
    """Actuator torque minus friction is Pinocchio's inverse dynamics plus the
    rotors.
    """
    rng = np.random.default_rng(3)
    busy, _ = validation_trials(plant, rng, seconds=2.0, points=1)
    log = simulate(plant, busy.reference, 1, imus=False)
    truth, rigid = log.truth, Rigid(plant.arm)
    rows = range(0, len(log.t), 7)
    tau = np.array([rigid.inverse(truth.q[k], truth.dq[k], truth.ddq[k]) for k in rows])
    left = (truth.tau - truth.friction)[::7] - tau
    scale = np.sqrt(np.mean(truth.tau**2, axis=0))
    assert (np.sqrt(np.mean(left**2, axis=0)) < 2e-3 * scale).all()


def test_stick_slip_holds_below_the_level_and_slips_above() -> None:
    """A block of 1 kg m^2 with 2 N m of stiction."""
    dry = Friction(np.array([2.0]), np.array([2.0]), np.zeros(1))
    one, rest = np.eye(1), np.zeros(1)
    for push, ddq, rub in (
        (1.9, 0.0, 1.9),
        (-2.0, 0.0, -2.0),
        (3.0, 1.0, 2.0),
        (-5.0, -3.0, -2.0),
    ):
        got, friction, _ = stick_slip(
            one, np.array([push]), rest, 1e-3, dry, np.zeros(1)
        )
        assert got[0] == pytest.approx(ddq)
        assert friction[0] == pytest.approx(rub)
