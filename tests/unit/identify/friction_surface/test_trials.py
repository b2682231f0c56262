"""Trials: gravity's columns, averages over slices, and what acceleration is left in
them.
"""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import without_acceleration
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.friction_surface.trials import Ramps, Trial, collect_trials
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.robot.kinematics import forward, gravity_columns, plane_across
from seqid_cli.robot.regressor import inverse_dynamics
from tests import Array
from tests.plants.motions.trajectories import sweeps
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r, random_model, robot_from_chain
from tests.plants.sensors import quantise

PRISMATIC = [False, True, False, False, True, False]
HOME = np.array([0.4, 0.0])
INERTIA, COULOMB, VISCOUS = 0.8, 2.0, 0.5
LINEAR = np.array([[COULOMB + 1.1 * VISCOUS, 0.9 * VISCOUS]])
SURFACE = FrictionSurface(
    scaling=Scaling((-1.6, 1.6), (0.2, 2.0)),
    sign_width=0.01,
    positive=LINEAR,
    negative=LINEAR,
    entry_covariance=np.zeros((2, 2)),
    directional=False,
)


@pytest.mark.parametrize("seed", range(3))
def test_columns_times_p_xi_are_the_gravity_torque(seed: int) -> None:
    """p_xi of Eq. 14 is the composite body's first moment across the axis,
    or its mass.
    """
    rng = np.random.default_rng(seed)
    model, chain = random_model(rng, PRISMATIC)
    phi = np.array([body.toDynamicParameters() for body in list(model.inertias)[1:]])
    robot = robot_from_chain(chain, gravity=np.array([3.0, -2.0, -8.0]))
    where, own = rng.uniform(-2, 2, robot.n), rng.uniform(-3, 3, 40)
    frames = forward(robot.chain, where[None])
    R, p = frames.R[0], frames.p[0]
    for joint in range(robot.n):
        q = np.tile(where, (40, 1))
        q[:, joint] = own
        still = np.zeros_like(q)
        tau = inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still)[
            :, joint
        ]
        p_xi = np.array([phi[joint:, 0].sum()])
        if not robot.chain.prismatic[joint]:
            arms = p[joint:] - p[joint]
            moment = phi[joint:, 0] @ arms + np.einsum(
                "kij,kj->i", R[joint:], phi[joint:, 1:4]
            )
            p_xi = np.array(plane_across(robot.chain.axis[joint])) @ R[joint].T @ moment
        found = gravity_columns(robot, joint, where, own) @ p_xi
        np.testing.assert_allclose(found, tau, rtol=1e-9, atol=1e-9)


def test_slices_average_position_and_torque() -> None:
    reference = sweeps(HOME, 1, (-1.5, 1.5), [0.3, 1.0], 8.0, rate_hz=250.0)
    counts = quantise(reference.q, 2 * np.pi / 600)
    log = made_recording(counts, 2.0 * reference.q + 1.0, rate_hz=250.0)
    trials = collect_trials([log], planar_2r())
    assert sorted(round(t.velocity, 2) for t in trials) == [-1.0, -0.3, 0.3, 1.0]
    for own in trials:
        assert own.joint == 1
        assert own.configuration[0] == pytest.approx(0.4, abs=0.006)
        np.testing.assert_allclose(own.tau, 2.0 * own.q + 1.0, atol=0.01)
        assert np.abs(own.ddq).max() < 0.1 * own.speed
        np.testing.assert_allclose(own.dq, own.velocity, rtol=0.1)
        # Means over a window of the ramps are those of torque and position alike.
        np.testing.assert_allclose(own.ramps.tau, 2.0 * own.ramps.q + 1.0, atol=0.02)
        assert np.abs(own.ramps.dq).min() < 0.5 * own.speed
        assert own.ramps.ddq.min() < -2.0 < 2.0 < own.ramps.ddq.max()
        assert len(own.q) * own.weight <= len(reference.q)


def test_trials_know_how_warm_the_joint_was() -> None:
    reference = sweeps(HOME, 1, (-1.0, 1.0), [0.5, 1.0], 10.0, rate_hz=250.0)
    cold = made_recording(reference.q, np.tanh(20.0 * reference.dq), rate_hz=250.0)
    celsius = np.column_stack([np.full(len(reference.q), 50.0), 20.0 + cold.t])
    celsius[::7] = np.nan
    warm = replace(cold, temperature=celsius)
    trials = collect_trials([warm], planar_2r())
    for own in trials:
        assert own.celsius == pytest.approx(20.0 + own.t.mean(), abs=0.05)
    assert all(np.isnan(own.celsius) for own in collect_trials([cold], planar_2r()))
    known, unknown = (
        identify_friction([log], planar_2r(), options=FrictionOptions()).joints[
            "joint_2"
        ]
        for log in (warm, cold)
    )
    assert trials[0].celsius < (known.temperature or 0.0) < trials[-1].celsius
    assert unknown.temperature is None


def trials_of(*, wobble: float = 0.0, seed: int = 0) -> list[Trial]:
    """Sweeps of the second joint, the speed wavering over the position, torque with
    white noise.
    """
    rng, rate = np.random.default_rng(seed), 500.0
    path = sweeps(HOME, 1, (-1.5, 1.5), [0.3, 0.8, 1.8], 6.0, rate_hz=rate).q
    path[:, 1] += wobble * np.sin(3.0 * path[:, 1])
    v, a = (
        np.gradient(path[:, 1]) * rate,
        np.gradient(np.gradient(path[:, 1])) * rate**2,
    )
    tau = np.zeros_like(path)
    tau[:, 1] = INERTIA * a + (COULOMB + VISCOUS * np.abs(v)) * np.sign(v)
    tau[:, 1] += 0.05 * rng.standard_normal(len(path))
    log = made_recording(quantise(path, 1e-4), tau, rate_hz=rate)
    return collect_trials([log], planar_2r())


def friction_left(trials: list[Trial]) -> Array:
    """What a trial at its mean velocity should not have beyond friction, away from its
    ends.
    """
    left = [
        t.tau - SURFACE.torque(t.q, np.full(len(t.tau), t.velocity)) for t in trials
    ]
    return np.concatenate([each[6:-6] for each in left])


def test_ramps_tell_the_inertia_and_its_torque_is_taken_off() -> None:
    off = []
    for seed in range(12):
        given = trials_of(wobble=0.01, seed=seed)
        (group,) = without_acceleration(planar_2r(), [given], SURFACE)
        off.append((group.inertia - INERTIA) / group.std_error)
        assert group.std_error < 0.02 * INERTIA
        assert np.std(friction_left(group.trials)) < 0.35 * np.std(friction_left(given))
    assert np.sqrt(np.mean(np.square(off))) < 1.8


def test_where_no_ramp_tells_anything_all_torque_may_be_that_of_acceleration() -> None:
    given = trials_of(wobble=0.01)
    blind = [replace(trial, ramps=Ramps()) for trial in given]
    (told,), (unknown,) = (
        without_acceleration(planar_2r(), [t], SURFACE) for t in (given, blind)
    )
    assert all(trial.inertia_error == told.std_error for trial in told.trials)
    assert unknown.inertia == 0.0
    for trial in unknown.trials:
        assert trial.inertia_error >= INERTIA
        pushed = max(
            trial.inertia_error * np.sqrt(np.mean(t.ddq**2)) for t in unknown.trials
        )
        assert pushed > 0.5 * np.median(np.abs(trial.tau))


def test_slices_in_which_a_controller_still_settles_are_left_out() -> None:
    given, *_ = [t for t in trials_of() if t.velocity > 1.0]
    # rad/s^2 by a path that overshoots
    pushed = np.where(np.arange(len(given.q)) < 3, 4.0, 0.0)
    trial = replace(given, ddq=pushed, tau=given.tau + 0.2 * INERTIA * pushed)
    (group,) = without_acceleration(planar_2r(), [[trial, *trials_of()]], SURFACE)
    kept = group.trials[0]
    assert kept.t == pytest.approx(trial.t[3:])
    assert len(kept.q) == len(kept.dq) == len(kept.ddq) == len(kept.tau) == len(kept.t)
    assert abs(friction_left([kept]).mean()) < 0.05
