"""The second simulator: energy, statics, and one arm identified to what it was drawn with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from seqid_cli import api
from seqid_cli.inspect.screening import read_screened
from seqid_cli.robot.file import load_robot
from tests.outside import motions
from tests.outside.__main__ import main, tabulated
from tests.outside.arms import GRAVITY, Arm, Link, drawn_arm, mjcf, robot_toml, urdf
from tests.outside.cases import RESERVED, SPEEDS, kind_of, record
from tests.outside.effects import KINDS
from tests.outside.simulate import simulate


def pendulum(mass: float = 2.0, reach: float = 0.4, coulomb: float = 0.0) -> Arm:
    """One link that points up at zero, about a horizontal axis."""
    link = Link(
        place=np.zeros(3),
        axis=np.array([0.0, 1.0, 0.0]),
        mass=mass,
        centre=np.array([0.0, 0.0, reach]),
        inertia=np.array([0.02, 0.02, 0.01]),
        rotor=0.1,
        coulomb=coulomb,
        waviness=0.1,
        phase=0.0,
        viscous=0.0,
        constant=8.0,
        count=1e-5,
    )
    return Arm((link,), 500.0, 0.0)


def test_a_swing_without_friction_keeps_its_energy() -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(pendulum()))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[:] = 2.0
    energies = []
    for _ in range(3000):
        mujoco.mj_step(model, data)
        energies.append(data.energy.sum())
    assert np.ptp(energies) < 0.01 * 2.0 * 2.0 * GRAVITY * 0.4


def test_the_torque_at_rest_is_the_weight() -> None:
    log = simulate(pendulum(), np.full((1500, 1), 0.7), seed=1)
    assert log.true_torque[-1, 0] == pytest.approx(-2.0 * GRAVITY * 0.4 * np.sin(0.7), rel=1e-3)
    assert log.current[-1, 0] * 8.0 == pytest.approx(log.true_torque[-1, 0], rel=1e-9)


def test_friction_holds_and_then_slides() -> None:
    """At constant speed both ways the torques differ by twice the friction."""
    arm = pendulum(coulomb=3.0)
    motion = motions.trial(1, 0, np.zeros(1), np.array([0.5]))
    log = simulate(arm, motion, seed=1)
    speed = np.gradient(log.q[:, 0], log.t)
    near = np.abs(log.q[:, 0] - 0.5) < 0.05
    up, down = (log.true_torque[near & (sign * speed > 0.4), 0].mean() for sign in (1, -1))
    assert 0.5 * (up - down) == pytest.approx(arm.links[0].friction(0.5), rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_every_effect_acts(kind: str) -> None:
    arm = drawn_arm(3)
    effect = KINDS[kind](arm, np.random.default_rng(3))
    motion = motions.multisine(len(arm.links), np.random.default_rng(4), 8.0)
    quiet = replace(arm, noise=0.0)
    with_it, without = (simulate(quiet, motion, 1, *e) for e in ((effect,), ()))
    apart = np.abs(with_it.current - without.current).max(axis=0)
    assert apart[effect.joint or 0] * arm.links[effect.joint or 0].constant > 0.1 * min(
        link.coulomb for link in arm.links
    )


def test_a_clean_pendulum_is_identified_to_within_its_errors(tmp_path: Path) -> None:
    arm = replace(pendulum(coulomb=1.0), noise=0.05)
    robot = tmp_path / "robot.toml"
    robot.write_text(robot_toml(arm))
    (tmp_path / "arm.urdf").write_text(urdf(arm))
    assert load_robot(robot).n == 1
    speeds = np.array([0.2, 0.4, 0.8, 1.6])
    trials = record(tmp_path / "t.parquet", arm, motions.trial(1, 0, np.zeros(1), speeds), 1)
    rng = np.random.default_rng(2)
    moves = record(tmp_path / "m.parquet", arm, motions.multisine(1, rng, 15.0), 2)
    files = [tmp_path / f"{k}.json" for k in range(2)]
    api.friction([trials], robot, output=files[0])
    gravity = api.gravity([trials], robot, files[0], output=files[1]).stages.gravity
    inertia = api.inertia([moves], robot, files[1]).stages.inertia
    assert gravity is not None
    assert inertia is not None
    weight = max(gravity.parameters, key=lambda p: abs(p.value))
    assert abs(abs(weight.value) - 2.0 * 0.4) < 4.0 * weight.std_error + 0.004
    felt = max(inertia.parameters, key=lambda p: abs(p.value))
    truth = 0.02 + 2.0 * 0.4**2 + 0.1
    assert abs(felt.value - truth) < 4.0 * felt.std_error + 0.01 * truth


def test_a_held_joint_that_another_shakes_is_not_judged(tmp_path: Path) -> None:
    """Its torque is the controller's law, -k_p (q - q_0) - k_d dq, whatever its friction."""
    arm = drawn_arm(2)
    (tmp_path / "robot.toml").write_text(robot_toml(arm))
    (tmp_path / "arm.urdf").write_text(urdf(arm))
    motion = motions.trial(3, 0, np.array([0.4, -0.3, 0.2]), SPEEDS[2:4])
    path = record(tmp_path / "t.parquet", arm, motion, 1)
    screened = read_screened(path, load_robot(tmp_path / "robot.toml"))
    assert np.ptp(screened.recording.q, axis=0)[1:].min() > 0.1
    assert screened.findings == ()


def test_reserved_seeds_are_for_the_reserved_set(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--seeds", f"{RESERVED - 1}:{RESERVED + 1}"])
    assert "tuning seeds are below 10000" in capsys.readouterr().err
    assert {kind_of(seed) for seed in range(16)} == {"clean", *KINDS}


def test_the_table_counts_by_kind() -> None:
    row = {"seed": 1, "verdict": "effect_found", "exact": False, "stages": "good", "named": True}
    rows = [{**row, "kind": "spring", "placed": True}, {**row, "kind": "spring", "placed": False}]
    text = tabulated(json.loads(json.dumps(rows)))
    assert "| spring | 2 | 100 % | 100 % | 0 % | 50 % | 100 % | 0 |" in text
