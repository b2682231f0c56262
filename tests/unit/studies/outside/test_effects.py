"""Every effect changes the torque as its name says."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.studies.outside import motions
from tests.studies.outside.arms import Arm
from tests.studies.outside.effects import KINDS, MORE
from tests.studies.outside.foreign import FOREIGN
from tests.studies.outside.plan import LEAST, MOST, sized
from tests.studies.outside.simulate import Effect, Log, built, simulate
from tests.unit.studies.outside.bench import pendulum, quiet_arm, sweeps

EVERY = {**KINDS, **MORE, **FOREIGN}


def made(
    kind: str, arm: Arm, joint: int = 0, scale: float = 1.0, seed: int = 3
) -> Effect:
    return EVERY[kind](arm, joint, np.random.default_rng(seed)).make(scale)


def sweep(arm: Arm, speeds: tuple[float, ...], *effects: Effect) -> Log:
    motion = motions.trial(
        arm, 0, np.zeros(arm.n), np.array(speeds) / arm.links[0].speed
    )
    return simulate(arm, motion, 1, effects, start=30.0)


def halves(kind: str, at: float = 0.6, speed: float = 0.6) -> tuple[float, float]:
    """What an effect adds at a place, up and down: half the difference and half the
    sum.
    """
    arm = pendulum(coulomb=1.0)
    plain, changed = sweep(arm, (speed,)), sweep(arm, (speed,), made(kind, arm))
    up, down = sweeps(plain.t, plain.q[:, 0], speed, at)
    more = (changed.torque - plain.torque)[:, 0]
    return 0.5 * (more[up].mean() - more[down].mean()), 0.5 * (
        more[up].mean() + more[down].mean()
    )


ODD = (
    "load_dependent_friction",
    "friction_change",
    "quadratic_drag",
    "thermal_friction",
)
ODD += (
    "stribeck",
    "nonlinear_viscous",
    "position_dependent_friction",
    "presliding_hysteresis",
)
EVEN = ("spring", "payload", "base_tilt", "torque_bias", "asymmetric_friction")


@pytest.mark.parametrize("kind", [*ODD, *EVEN])
def test_friction_alone_turns_with_the_direction(kind: str) -> None:
    odd, even = halves(
        kind, speed={"stribeck": 0.2, "nonlinear_viscous": 1.2}.get(kind, 0.6)
    )
    own, other = (odd, even) if kind in ODD else (even, odd)
    # far from a reversal the bristles carry all of their part
    if kind == "presliding_hysteresis":
        assert abs(own) < 0.03
    else:
        assert abs(own) > 0.03
    assert abs(other) < 0.2 * abs(own) + 0.01


def twist(arm: Arm, effect: Effect, torque: float) -> float:
    """Angle of the link beyond its motor, which is held, under a torque (without
    weight).
    """
    model = built(arm, [effect])
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    motor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "j1_motor")
    model.dof_damping[1 - motor] = 2.0
    for _ in range(3000):
        data.qfrc_applied[motor] = -1e4 * data.qpos[motor] - 50.0 * data.qvel[motor]
        data.qfrc_applied[1 - motor] = torque
        mujoco.mj_step(model, data)
    return float(data.qpos[1 - motor] - data.qpos[motor])


def test_gears_twist_and_have_gaps() -> None:
    arm = pendulum()
    elastic, loose = made("joint_elasticity", arm), made("backlash", arm)
    stiffness = arm.drives[0].rotor * (2.0 * np.pi * 25.0) ** 2
    assert twist(arm, elastic, 2.0) == pytest.approx(2.0 / stiffness, rel=0.02)
    flanks = [twist(arm, loose, torque) for torque in (0.05, -0.05)]
    assert flanks == pytest.approx([0.0015, -0.0015], abs=2e-4)


def test_a_moved_zero_lets_the_arm_stand_elsewhere_and_still() -> None:
    arm = pendulum()
    motion = np.full((600, 1), 0.5)
    plain = simulate(arm, motion, 1)
    moved = simulate(arm, motion, 1, [made("joint_zero", arm, scale=5.0)])
    assert moved.q[0, 0] == pytest.approx(0.5, abs=1e-5)  # as the encoder says
    assert abs(moved.torque[0, 0] - moved.torque[-1, 0]) < 0.5
    # 0.05 rad more, of a weight of 2 kg at 0.4 m that leans by half a radian
    apart = abs(moved.torque[-1, 0] - plain.torque[-1, 0])
    assert apart == pytest.approx(2.0 * 9.81 * 0.4 * 0.05 * np.cos(0.5), rel=0.15)


def test_a_rope_takes_tenths_of_a_radian_to_turn() -> None:
    """After a reversal its torque goes over to the other side, whatever the speed."""
    arm = pendulum(coulomb=1.0)
    for speed in (0.3, 1.0):
        plain, changed = (
            sweep(arm, (speed,)),
            sweep(arm, (speed,), made("hysteresis", arm)),
        )
        more = (changed.torque - plain.torque)[:, 0]
        turns = int(np.argmax(plain.q[:, 0]))
        since = plain.q[turns, 0] - plain.q[turns:, 0]
        at = [turns + int(np.argmax(since > way)) for way in (0.02, 1.2)]
        assert more[at[0]] > 0.2  # still almost all of the 0.4 N m of before
        assert more[at[1]] == pytest.approx(-0.4, abs=0.08)


def test_what_sensors_say() -> None:
    """Sensors' effects as functions of the true torque and time, exactly."""
    arm = replace(
        quiet_arm(6), drives=tuple(replace(d, coulomb=2.0) for d in quiet_arm(6).drives)
    )
    t = 100.0 + np.arange(0.0, 4.0, 1e-3)
    own, more = np.sin(3.0 * t), {}
    for kind in (
        "torque_constant",
        "torque_saturation",
        "torque_bias",
        "drift",
        "time_skew",
    ):
        more[kind] = made(kind, arm).told(1.0, own, t) - own
    np.testing.assert_allclose(
        np.abs(more["torque_constant"]), 0.05 * np.abs(own), atol=1e-12
    )
    np.testing.assert_allclose(
        more["torque_saturation"], 0.05 * own**3 / 400.0, atol=1e-12
    )
    np.testing.assert_allclose(np.abs(more["torque_bias"]), 0.8, atol=1e-12)
    np.testing.assert_allclose(np.abs(more["drift"]), 2.0 * t / 60.0, atol=1e-9)
    late = np.abs(np.interp(t - 0.003, t, own) - own)
    early = np.abs(np.interp(t + 0.003, t, own) - own)
    assert (
        min(np.abs(np.abs(more["time_skew"]) - x)[10:-10].max() for x in (late, early))
        < 1e-9
    )


@pytest.mark.parametrize("kind", EVERY)
def test_every_effect_comes_in_the_size_that_was_drawn(kind: str) -> None:
    arm, rng = quiet_arm(8), np.random.default_rng(list(kind.encode()))
    effect, share = sized(arm, EVERY[kind](arm, 1, rng), rng)
    assert effect.name == kind
    least = (
        0.002
        if kind in ("presliding_hysteresis", "actuator_lag", "backlash")
        else LEAST
    )
    assert 0.8 * least < share < 1.2 * MOST
