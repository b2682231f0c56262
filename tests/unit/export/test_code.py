"""The C header and the numpy module against Pinocchio and MuJoCo: torque, observer, alarms."""

import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from seqid_cli.export.code import identifier
from seqid_cli.export.formats import export
from seqid_cli.export.observer import thresholds
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import TorqueModel, friction_surfaces
from seqid_cli.params.io import read_parameters
from seqid_cli.robot.types import Array, Robot
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_GANTRY, urdf_gantry
from tests.plants.robots.stages import SAMPLES, friction_stage
from tests.unit.export.arms import Arm, made, pinocchio_model, rigid, sample, states, written

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
DT = 2e-3


def run_c(folder: Path, robot: Robot, text: str, body: str, rows: Array) -> Array:
    """Compile the header with a `body` that turns a row of numbers x into y, and run it."""
    name = identifier(robot.name)
    (folder / "arm.h").write_text(text)
    (folder / "main.c").write_text(
        f'#include <stdio.h>\n#include "arm.h"\n'
        f"enum {{ N = {robot.n}, WIDTH = {rows.shape[1]} }};\n"
        f"int main(void) {{ double x[WIDTH], y[N]; int i, row; {name}_observer o;\n"
        f"for (i = 0; i < N; ++i) y[i] = 0.0;\n"
        f"{name}_observer_start(&o, y, y);\n"
        "for (row = 0;; ++row) {\n"
        'for (i = 0; i < WIDTH; ++i) if (scanf("%lf", &x[i]) != 1) return 0;\n'
        f"{body.replace('ARM', name)}\n"
        'for (i = 0; i < N; ++i) printf("%.17g ", y[i]);\nprintf("\\n"); } }\n'
    )
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    command = ["cc", *flags, "-o", str(folder / "main"), str(folder / "main.c"), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    typed = "\n".join(" ".join(f"{x!r}" for x in row) for row in rows.tolist())
    ran = subprocess.run(
        [str(folder / "main")], input=typed, capture_output=True, text=True, check=True
    )
    return np.array([[float(word) for word in line.split()] for line in ran.stdout.splitlines()])


def c_torques(folder: Path, robot: Robot, text: str) -> Array:
    rows = np.concatenate(states(robot.n), axis=1)
    return run_c(folder, robot, text, "ARM_torque(x, x + N, x + 2 * N, y);", rows)


def module_of(text: str) -> ModuleType:
    module = ModuleType("arm")
    exec(compile(text, "arm.py", "exec"), module.__dict__)
    return module


def numpy_torques(robot: Robot, text: str) -> Array:
    module = module_of(text)
    return np.array([module.torque(*row) for row in zip(*states(robot.n), strict=True)])


def test_the_numpy_module_computes_the_predicted_torque(arm: Arm) -> None:
    robot, stages = arm
    q, dq, _ = states(robot.n)
    expected = rigid(arm) + TorqueModel.from_stages(stages, robot).friction(q, dq)
    torque = numpy_torques(robot, written(arm, "numpy module").text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@needs_cc
def test_the_c_header_computes_the_predicted_torque(arm: Arm, tmp_path: Path) -> None:
    robot, stages = arm
    q, dq, ddq = states(robot.n)
    model = TorqueModel.from_stages(stages, robot)
    expected = model.rigid(q, dq, ddq) + model.friction(q, dq)
    torque = c_torques(tmp_path, robot, written(arm, "C header").text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@needs_cc
@pytest.mark.parametrize("log", [False, True])
def test_code_keeps_directions_speed_scales_and_coupled_rotors(tmp_path: Path, log: bool) -> None:
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 8, known=True)
    stages.inertia.rotor_coupling = "gyroscopic"
    stages.friction = friction_stage(robot, directional=True, log=log)
    stages.friction.joints.pop("reach")
    q, dq, ddq = states(robot.n)
    model = TorqueModel.from_stages(stages, robot)
    expected = model.rigid(q, dq, ddq) + model.friction(q, dq)
    done = export(robot, stages, kind="C header")
    torque = c_torques(tmp_path, robot, done.text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    torque = numpy_torques(robot, export(robot, stages, kind="numpy module").text)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def frictionless(arm: Arm) -> Arm:
    stages = arm[1]
    stages.friction.joints.clear()
    return arm


def c_observed(folder: Path, arm: Arm, rows: Array) -> Array:
    """External torque after each row (q, tau) of samples DT apart; the first is the start."""
    body = (
        f"if (row == 0) ARM_observer_start(&o, x, x + N); else ARM_observe(&o, x, x + N, {DT!r});"
        " for (i = 0; i < N; ++i) y[i] = o.external[i];"
    )
    return run_c(folder, arm[0], written(arm, "C header").text, body, rows)


def numpy_observed(module: ModuleType, rows: Array, dt: float = DT) -> tuple[Array, Array]:
    """External torque, and whether an alarm is raised at a joint, both (N, n)."""
    q, tau = np.split(rows, 2, axis=1)
    observer = module.Observer(q[0], tau[0])
    found, alarms = [observer.external], [np.zeros(q.shape[1], dtype=bool)]
    for row in zip(q[1:], tau[1:], strict=True):
        alarms.append(observer.update(*row, dt))
        found.append(observer.external)
    return np.array(found), np.array(alarms)


def numpy_module(arm: Arm) -> ModuleType:
    return module_of(written(arm, "numpy module").text)


@pytest.mark.slow
def test_momentum_and_what_changes_it_are_those_of_pinocchio(arm: Arm) -> None:
    """p = M dq and tau - g + C^T dq, with M, C and g by Pinocchio of the exported URDF."""
    robot, urdf = frictionless(arm)[0], written(arm, "URDF")
    model = pinocchio_model(robot, urdf.text, urdf.model.armature)
    data, start, module = model.createData(), pin.neutral(model), numpy_module(arm)
    for q, v, tau in zip(*states(robot.n), strict=True):
        at = pin.integrate(model, start, q)
        M = np.triu(pin.crba(model, data, at))
        p, drive = module._momentum(q, v, tau)
        np.testing.assert_allclose(p, (M + np.triu(M, 1).T) @ v, atol=1e-9 * np.abs(p).max())
        expected = tau + pin.computeCoriolisMatrix(model, data, at, v).T @ v
        expected -= pin.computeGeneralizedGravity(model, data, at)
        np.testing.assert_allclose(drive, expected, atol=1e-8 * np.abs(drive).max())


@needs_cc
def test_both_observers_are_the_same(tmp_path: Path) -> None:
    for rig in ("one_joint", "six_joint"):
        (tmp_path / rig).mkdir()
        arm = sample(rig)
        q, _, tau = states(arm[0].n)
        rows = np.concatenate([0.01 * q, tau], axis=1)
        expected, _ = numpy_observed(numpy_module(arm), rows)
        found = c_observed(tmp_path / rig, arm, rows)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_a_push_in_mujoco_is_what_the_observer_finds() -> None:
    """The arm falls and swings; from 0.3 s on a torque acts that the motors do not know."""
    arm = frictionless(sample("six_joint"))
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
    found, _ = numpy_observed(numpy_module(arm), np.array(rows))
    assert np.abs(found[100:150]).max() < 0.3  # the release at the start has died away
    np.testing.assert_allclose(found[-1], push, atol=0.3)


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("rig", ["one_joint", "two_joint"])
def test_new_logs_raise_no_alarm_and_a_collision_does(tmp_path: Path, rig: str) -> None:
    """The model of the sample logs on logs that it has not seen, as recorded and with a push."""
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
        push = 3.0 * (limits.limit + limits.stiction) * (log.t > 0.5 * log.t[-1])[:, None]
        pushed = log.tau - push  # the controller holds the motion, and the motors give way
        for tau, from_ in ((log.tau, None), (pushed, 0.5 * log.t[-1])):
            rows = np.concatenate([log.q, tau], axis=1)
            alarms = log.t[run_c(tmp_path, robot, header.text, body, rows)[:, 0] >= 0]
            if from_ is None:
                assert len(alarms) == 0
            else:
                assert from_ < alarms[0] < from_ + 4.0 / limits.gain


def test_limits_follow_from_noise_encoder_and_band() -> None:
    """Rice: sqrt(2 ln(2 n f T)) standard deviations; the gain where the encoder adds as much."""
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
