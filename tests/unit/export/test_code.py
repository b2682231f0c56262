"""The C header and the numpy module against Pinocchio and MuJoCo: torque, observer,
alarms.
"""

import shutil
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from seqid_cli.export.observer import thresholds
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import TorqueModel, friction_surfaces
from seqid_cli.params.io import read_parameters
from seqid_cli.robot.types import Array
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_GANTRY, urdf_gantry
from tests.plants.robots.stages import SAMPLES, friction_stage
from tests.unit.export.arms import Arm, agree, made, sample, states, written
from tests.unit.export.compiled import run_c

CC = shutil.which("cc")
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler here")
DT = 2e-3


def numpy_module(arm: Arm) -> ModuleType:
    module = ModuleType("arm")
    exec(compile(written(arm, "numpy module").text, "arm.py", "exec"), module.__dict__)
    return module


def check_torques(arm: Arm, folder: Path) -> None:
    """Both forms of code compute what the model predicts."""
    robot, stages = arm
    model, (q, dq, ddq) = TorqueModel.from_stages(stages, robot), states(robot.n)
    expected = model.rigid(q, dq, ddq) + model.friction(q, dq)
    module = numpy_module(arm)
    rows = zip(q, dq, ddq, strict=True)
    agree(np.array([module.torque(*row) for row in rows]), expected, 1e-10)
    if CC is not None:
        body, text = (
            "ARM_torque(x, x + N, x + 2 * N, y);",
            written(arm, "C header").text,
        )
        agree(
            run_c(folder, robot, text, body, np.hstack([q, dq, ddq])), expected, 1e-10
        )


def test_code_computes_the_predicted_torque(arm: Arm, tmp_path: Path) -> None:
    check_torques(arm, tmp_path)


@pytest.mark.parametrize("log", [False, True])
def test_code_keeps_directions_speed_scales_and_coupled_rotors(
    tmp_path: Path, log: bool
) -> None:
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 8, known=True)
    stages.inertia.rotor_coupling = "gyroscopic"
    stages.friction = friction_stage(robot, directional=True, log=log)
    stages.friction.joints.pop("reach")
    check_torques((robot, stages), tmp_path)


def numpy_observed(module: ModuleType, rows: Array) -> Array:
    """External torque (N, n) after each row (q, tau) of samples DT apart, from the
    first on.
    """
    q, tau = np.split(rows, 2, axis=1)
    observer = module.Observer(q[0], tau[0])
    found = [observer.external]
    for row in zip(q[1:], tau[1:], strict=True):
        observer.update(*row, DT)
        found.append(observer.external)
    return np.array(found)


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("rig", ["one_joint", "six_joint"])
def test_both_observers_are_the_same(tmp_path: Path, rig: str) -> None:
    arm = sample(rig)
    q, _, tau = states(arm[0].n)
    rows = np.hstack([0.01 * q, tau])
    body = (
        "if (row == 0) ARM_observer_start(&o, x, x + N); else ARM_observe(&o, x, x +"
        f" N, {DT!r}); for (i = 0; i < N; ++i) y[i] = o.external[i];"
    )
    found = run_c(tmp_path, arm[0], written(arm, "C header").text, body, rows)
    agree(found, numpy_observed(numpy_module(arm), rows), 1e-9)


@pytest.mark.slow
def test_a_push_in_mujoco_is_what_the_observer_finds() -> None:
    """The arm falls and swings; from 0.3 s on a torque acts that the motors do not
    know.
    """
    arm = sample("six_joint")
    arm[1].friction.joints.clear()
    model = mujoco.MjModel.from_xml_string(written(arm, "MJCF").text)
    model.opt.timestep, model.opt.integrator = DT / 4, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, rows = mujoco.MjData(model), []
    push = np.array([12.0, -20.0, 8.0, 0.0, 3.0, 1.0])
    for k in range(250):
        motors = np.sin(0.02 * k + np.arange(6))
        rows.append(np.concatenate([data.qpos, motors]))
        data.ctrl[:] = motors
        data.qfrc_applied[:] = push * (k >= 150)
        mujoco.mj_step(model, data, nstep=4)
    found = numpy_observed(numpy_module(arm), np.array(rows))
    assert np.abs(found[100:150]).max() < 0.3  # the release at the start has died away
    np.testing.assert_allclose(found[-1], push, atol=0.3)


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("rig", ["one_joint", "two_joint"])
def test_new_logs_raise_no_alarm_and_a_collision_does(tmp_path: Path, rig: str) -> None:
    """The model of the sample logs on logs that it has not seen, as recorded and with a
    push.
    """
    robot = sample_robot(rig)
    arm = (robot, read_parameters(SAMPLES / rig / "golden.json").stages)
    header = written(arm, "C header")
    limits = header.model.observer
    for path in sorted((SAMPLES / rig / "validation").iterdir()):
        log = read_recording(path, robot)
        body = (
            "if (row == 0) { ARM_observer_start(&o, x, x + N); y[0] = -1; }"
            f" else y[0] = ARM_observe(&o, x, x + N, {1.0 / log.rate_hz!r});"
        )
        push = (
            3.0 * (limits.limit + limits.stiction) * (log.t > 0.5 * log.t[-1])[:, None]
        )
        # the controller holds the motion, and the motors give way
        pushed = log.tau - push
        quiet, alarms = (
            log.t[
                run_c(tmp_path, robot, header.text, body, np.hstack([log.q, tau]))[:, 0]
                >= 0
            ]
            for tau in (log.tau, pushed)
        )
        assert len(quiet) == 0
        assert 0.5 * log.t[-1] < alarms[0] < 0.5 * log.t[-1] + 4.0 / limits.gain


def test_limits_follow_from_noise_encoder_and_band() -> None:
    """Rice: sqrt(2 ln(2 n f T)) standard deviations; the gain where the encoder adds as
    much.
    """
    robot, stages = sample("two_joint")
    stages.inertia.cutoff_hz, mass = 10.0, np.diag([2.0, 1.0])
    surfaces = friction_surfaces(stages, robot)
    step = robot.joints[0].encoder_resolution
    errors = {"joint_1": 2.0, "joint_2": 100.0}
    found = thresholds(robot, stages, surfaces, mass, errors, margin=1.0)
    factor = np.sqrt(2.0 * np.log(2.0 * 2 * 10.0 * 24.0 * 3600.0))
    assert found.gain == pytest.approx(np.sqrt(2.0 / (2.0 * step / np.sqrt(12.0))))
    assert found.limit[0] == pytest.approx(factor * 2.0 * np.sqrt(2.0))
    assert (found.stiction > 0.0).all()
    unknown = thresholds(robot, stages, surfaces, mass, {"joint_1": 2.0})
    assert np.isinf(unknown.limit[1])
