"""The second simulator: energy, statics, files, sensors, and a clean arm identified."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from seqid_cli import identify
from seqid_cli.inspect.screening import read_screened
from seqid_cli.robot.file import load_robot
from tests.studies.outside import motions
from tests.studies.outside.arms import drawn_arm
from tests.studies.outside.cases import SPEEDS, write
from tests.studies.outside.plan import PUBLISHED
from tests.studies.outside.robotfiles import robot_toml, urdf
from tests.studies.outside.simulate import built, simulate
from tests.unit.studies.outside.bench import pendulum, quiet_arm


@pytest.mark.parametrize("label", [*PUBLISHED, "drawn"])
def test_simulator_and_urdf_are_one_arm(label: str) -> None:
    """Weight and mass matrix in MuJoCo, and by Pinocchio from the URDF, some links
    locked.
    """
    rng = np.random.default_rng(1)
    arm = drawn_arm(rng, label, 3, imus=False)
    model = built(arm)
    data = mujoco.MjData(model)
    other = pin.buildModelFromXML(urdf(arm))
    for _ in range(3):
        data.qpos[:] = rng.uniform(-1.0, 1.0, 3)
        mujoco.mj_forward(model, data)
        mass = np.zeros((3, 3))
        mujoco.mj_fullM(model, data, mass)
        rigid = mass - np.diag(arm.of("rotor"))
        theirs = other.createData()
        symmetric = pin.crba(other, theirs, data.qpos)
        np.testing.assert_allclose(rigid, symmetric, atol=1e-6 * np.abs(rigid).max())
        weight = pin.computeGeneralizedGravity(other, theirs, data.qpos)
        np.testing.assert_allclose(
            data.qfrc_bias, weight, atol=1e-6 * np.abs(weight).max() + 1e-9
        )


def test_logged_torque_is_inverse_dynamics_and_friction() -> None:
    """MuJoCo's inverse dynamics of the logged motion, and friction,
    make up the torque.
    """
    arm = quiet_arm(4)
    arm = replace(arm, drives=tuple(replace(d, count=1e-9) for d in arm.drives))
    log = simulate(arm, motions.multisine(arm, np.random.default_rng(2), 6.0), seed=1)
    dq = np.gradient(log.q, log.t, axis=0)
    ddq = np.gradient(dq, log.t, axis=0)
    model = built(arm)
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    rigid = np.empty_like(dq)
    for k in range(len(dq)):
        data.qpos[:], data.qvel[:], data.qacc[:] = log.q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        rigid[k] = data.qfrc_inverse
    coulomb, waves, phase = (arm.of(name) for name in ("coulomb", "waviness", "phase"))
    friction = np.sign(dq) * coulomb * (1.0 + waves * np.sin(log.q + phase))
    slides = np.abs(dq).min(axis=1) > 0.1
    apart = (log.true_torque - rigid - friction)[slides]
    assert slides.sum() > 300
    assert np.median(np.abs(apart), axis=0) == pytest.approx(
        0.0, abs=0.05 * coulomb.min()
    )


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_a_clean_pendulum_is_identified_to_within_its_errors(
    tmp_path: Path, suffix: str
) -> None:
    arm = replace(pendulum(coulomb=1.0), noise=0.05)
    robot = tmp_path / "robot.toml"
    robot.write_text(robot_toml(arm))
    (tmp_path / "arm.urdf").write_text(urdf(arm))
    rng, logs = np.random.default_rng(2), []
    sweeping = motions.trial(arm, 0, np.zeros(1), SPEEDS)
    for name, motion in (
        ("trial", sweeping),
        ("moves", motions.multisine(arm, rng, 15.0)),
    ):
        log = simulate(arm, motion, seed=1)
        logs.append(tmp_path / f"{name}.{suffix}")
        write(logs[-1], arm, log, log.t + 5.0)
    files = [tmp_path / f"{k}.json" for k in range(2)]
    identify.friction(logs[:1], robot, output=files[0])
    gravity = identify.gravity(
        logs[:1], robot, files[0], output=files[1]
    ).stages.gravity
    inertia = identify.inertia(logs[1:], robot, files[1]).stages.inertia
    weight = max(gravity.parameters, key=lambda p: abs(p.value))
    assert abs(abs(weight.value) - 2.0 * 0.4) < 4.0 * weight.std_error + 0.004
    felt = max(inertia.parameters, key=lambda p: abs(p.value))
    truth = 0.02 + 2.0 * 0.4**2 + 0.1
    assert abs(felt.value - truth) < 4.0 * felt.std_error + 0.01 * truth


def test_a_held_joint_that_another_shakes_is_not_judged(tmp_path: Path) -> None:
    """Its torque is the controller's law, -k_p (q - q_0) - k_d dq, whatever its
    friction.
    """
    arm = replace(
        drawn_arm(np.random.default_rng(2), "drawn", 3, imus=False),
        bandwidth=12.0,
        forward=0.3,
    )
    (tmp_path / "robot.toml").write_text(robot_toml(arm))
    (tmp_path / "arm.urdf").write_text(urdf(arm))
    log = simulate(
        arm, motions.trial(arm, 0, np.array([0.4, -0.3, 0.2]), SPEEDS[2:]), seed=1
    )
    write(tmp_path / "t.parquet", arm, log, log.t)
    screened = read_screened(
        tmp_path / "t.parquet", load_robot(tmp_path / "robot.toml")
    )
    assert np.ptp(screened.recording.q, axis=0)[1:].min() > 0.02
    assert screened.findings == ()
