"""One least squares for rigid body, Coulomb, viscous friction and offset (Eq. 5-6)."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from tests.plants.arms.rigs import six_joint
from tests.plants.mechanics.rigid import PHI_NAMES
from tests.plants.motions.trajectories import fourier
from tests.plants.robots.lab import true_value
from tests.plants.robots.made import made_recording
from tests.plants.robots.sample import rmse
from tests.plants.robots.small import arm_6r
from tests.plants.robots.two_joint import two_joint_robot

RATE = 100.0
COULOMB, VISCOUS, OFFSET = (
    4.0 - 0.5 * np.arange(6),
    2.0 - 0.2 * np.arange(6),
    0.1 * np.arange(6),
)
NOISE = 0.3
PHI = six_joint().arm.phi
LIMIT = np.full(2, 1.0)


def robot() -> Robot:
    plain = arm_6r()
    return replace(
        plain, joints=tuple(replace(j, rotor_inertia=0.0) for j in plain.joints)
    )


def record(seed: int, seconds: float = 60.0, half: float = 2.0) -> Recording:
    """Exact inverse dynamics with the classical friction, on one Fourier series of
    +-`half` rad.
    """
    rng = np.random.default_rng(seed)
    end, top = np.full(6, half), np.full(6, 2.0)
    motion = fourier(
        rng, -end, end, top, 4 * top, seconds=seconds, harmonics=25, rate_hz=RATE
    )
    arm = robot()
    tau = inverse_dynamics(arm.chain, arm.gravity, PHI, motion.q, motion.dq, motion.ddq)
    tau += COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq + OFFSET
    return made_recording(
        motion.q,
        tau + NOISE * rng.standard_normal(tau.shape),
        rate_hz=RATE,
        path=f"log_{seed}",
    )


def identified(
    *logs: Recording, arm: Robot | None = None, offset: bool = True
) -> Stages:
    options = MotionOptions(8.0)
    friction, inertia = identify_simultaneous(
        logs, arm or robot(), options=options, offset=offset
    )
    return Stages(friction=friction, inertia=inertia)


def test_rigid_body_and_friction_are_recovered_and_predict_a_new_motion() -> None:
    stages = identified(record(1), record(2))
    names = [f"{kind}_{i}" for i in range(1, 7) for kind in PHI_NAMES]
    standard = dict(zip(names, PHI.ravel().tolist(), strict=True))
    stage = stages.inertia
    assert stage.rank == stage.structural_rank == len(stage.parameters) == 36
    z = [
        (p.value - true_value(p.terms, standard)) / p.std_error
        for p in stage.parameters
    ]
    assert np.mean(np.abs(z) < 3) >= 0.95
    assert np.abs(z).max() < 5
    found = [
        [p.value for p in joint.parameters] for joint in stages.friction.joints.values()
    ]
    np.testing.assert_allclose(np.array(found).T, [COULOMB, VISCOUS, OFFSET], atol=0.06)
    options = InertiaOptions(motion=MotionOptions(8.0))
    predicted = list(predict([record(3, 20.0)], robot(), stages, options=options))
    # White noise below the cut-off; reversals, where the sign is smoothed, come on top.
    assert (rmse(predicted) < 1.5 * NOISE * np.sqrt(2 * 8.0 / RATE) + 0.05).all()


def test_the_stated_error_of_friction_has_what_waves_over_the_position() -> None:
    """Errors of the law's coefficients alone hold the truth at half of the places."""
    share = 0.15
    log = record(1)
    wave = share * COULOMB * np.cos(log.q + 0.4) * np.sign(np.gradient(log.q, axis=0))
    stages = identified(replace(log, tau=log.tau + wave))
    rng = np.random.default_rng(3)
    z = []
    of_entries = []
    for k, joint in enumerate(stages.friction.joints.values()):
        assert joint.law_error == pytest.approx(
            share * COULOMB[k] / np.sqrt(2), rel=0.2
        )
        surface = FrictionSurface.from_stage(joint)
        q = rng.uniform(*joint.position_range, 50)
        v = rng.uniform(0.2, 0.9, 50) * joint.speed_range[1]
        truth = (
            COULOMB[k] * (1.0 + share * np.cos(q + 0.4)) + VISCOUS[k] * v + OFFSET[k]
        )
        error = surface.torque(q, v) - truth
        z += (error / surface.stated_error(q, v)).tolist()
        of_entries += (error / surface.std_error(q, v)).tolist()
    assert np.mean(np.abs(z) < 1.96) >= 0.92
    assert np.mean(np.abs(of_entries) < 1.96) < 0.7


@pytest.mark.parametrize("offset", [True, False])
def test_offsets_do_not_go_into_the_base_parameters(*, offset: bool) -> None:
    """On short moves of one posture gravity takes what offsets would, and is sure of
    it.
    """
    plain = record(1, 30.0, 0.5)
    found = [
        identified(log, offset=offset).inertia.parameters
        for log in (plain, replace(plain, tau=plain.tau + 0.5))
    ]
    moves = np.array([b.value - a.value for a, b in zip(*found, strict=True)])
    errors = np.array([b.std_error for b in found[1]])
    assert bool((np.abs(moves) < 1e-6 * errors).all()) is offset
    assert bool((np.abs(moves) > errors).any()) is not offset


def test_offsets_that_moves_do_not_tell_from_gravity_are_named() -> None:
    inertia = identified(record(1, 30.0, 0.005)).inertia
    assert any("--no-offset" in note for note in inertia.notes), inertia.notes
    assert not all(verdict.good for verdict in inertia.verdicts)


def test_joints_that_rest_are_named() -> None:
    log = record(4, 20.0)
    log.q[:, 5] = 0.3
    found = identified(log)
    still = [
        (v.joint, v.good) for v in found.inertia.verdicts if "does not move" in v.reason
    ]
    assert still == [("joint_6", False)]
    assert "joint_6" not in found.friction.joints


def test_a_log_that_hardly_moves_a_joint_does_not_say_how_fast_it_slides() -> None:
    crawling = record(5, 20.0)
    crawling.q[:, 5] *= 1e-3
    logs = [crawling, record(6, 20.0)]
    found, other = (identified(*given).friction.joints for given in (logs, logs[::-1]))
    for name, joint in found.items():
        assert joint.sign_width == pytest.approx(other[name].sign_width)
        assert joint.sign_width > 1e-3 * joint.speed_range[1]


def test_a_joint_that_slides_has_units_of_its_own() -> None:
    rng = np.random.default_rng(0)
    motion = fourier(
        rng, -LIMIT, LIMIT, LIMIT, 4 * LIMIT, seconds=20.0, harmonics=10, rate_hz=RATE
    )
    arm = two_joint_robot(prismatic=True, drives=False)
    phi = np.zeros((2, 10))
    phi[:, [0, 1, 4, 6, 9]] = 2.0, 0.3, 0.1, 0.2, 0.2
    tau = inverse_dynamics(arm.chain, arm.gravity, phi, motion.q, motion.dq, motion.ddq)
    log = made_recording(motion.q, tau + 3.0 * np.tanh(motion.dq / 0.01), rate_hz=RATE)
    found = identified(log, arm=arm)
    turns, slides = found.friction.joints.values()
    assert (turns.unit, slides.unit) == ("N m", "N")
    assert [p.unit for p in turns.parameters] == ["N m", "N m s/rad", "N m"]
    assert [p.unit for p in slides.parameters] == ["N", "N s/m", "N"]
    told = {verdict.joint: verdict.reason for verdict in found.inertia.verdicts}
    assert " N m), noise up to " in told["joint_1"]
    assert " N), noise up to " in told["joint_2"]
    assert told["joint_1"].endswith(" N m")
    assert told["joint_2"].endswith(" N")


def test_friction_that_drives_is_not_good() -> None:
    log = record(7, 20.0)
    driven = log.tau - 2 * COULOMB * np.sign(np.gradient(log.q, axis=0)) * (
        np.arange(6) == 3
    )
    verdicts = identified(replace(log, tau=driven)).inertia.verdicts
    driving = [v for v in verdicts if v.joint and "cannot be" in v.reason]
    assert [(v.joint, v.good) for v in driving] == [("joint_4", False)]
