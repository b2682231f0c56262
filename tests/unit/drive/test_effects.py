"""Effects of the model's file in a replay, against arms that have them."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from msgspec import structs

from seqid_cli import drive as drives
from seqid_cli.drive.effects import arm_effects
from seqid_cli.drive.signals import signals_of
from seqid_cli.effects.fitted import FittedEffect, as_stage
from seqid_cli.effects.registry import catalogue_of
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.results.drive import DriveFile, DriveParameter, JointDrive
from seqid_cli.params.results.replay import ReplayFile
from seqid_cli.params.schema import EffectOfJoint, Stages
from tests import Array
from tests.plants.driven import DrivenArm, drawn_arm, multisine, simulate_drive

SECONDS = 3.0
NARROW = 0.002  # rad/s, over which the plant's friction changes sides
Resists = Callable[[Array, Array, Array], Array]


@cache
def soft_arm() -> DrivenArm:
    """An arm of one joint with a drive that friction moves off its way."""
    drawn = drawn_arm(2, 1)
    return drawn.with_drive(
        proportional=0.4 * drawn.drive.proportional,
        velocity_feedforward=np.zeros(1),
        integral=np.zeros(1),
        gravity_compensation=np.zeros(1),
        command_delay=0.01,
        torque_lag=0.0,
    )


def true_drive(stages: Stages) -> DriveFile:
    """The drive of the arm as it is, with a model of it."""
    arm = soft_arm()
    values = {
        "command_delay": arm.drive.command_delay,
        "proportional": float(arm.drive.proportional[0]),
        "derivative": float(arm.drive.derivative[0]),
    }
    parameters = [
        DriveParameter(
            name=name, value=value, std_error=1e-3, unit="", state="identified"
        )
        for name, value in values.items()
    ]
    joint = JointDrive(
        parameters=parameters,
        command="interpolated",
        command_known=True,
        left=0.0,
        rmse=0.0,
        samples=1000,
    )
    return DriveFile(
        **head("seqid/drive@1", "2026-01-01T00:00:00Z"),
        robot=robot_id(arm.robot),
        inputs=[],
        models=[],
        method="torque",
        command_delay=None,
        joints={"joint_1": joint},
        stages=stages,
    )


def effect(
    name: str, coefficients: list[float], settings: Mapping[str, float] | None = None
) -> EffectOfJoint:
    robot = soft_arm().robot
    c = np.array(coefficients)
    fitted = FittedEffect(
        effect=catalogue_of(robot)[name],
        joint=0,
        settings=settings or {},
        coefficients=c,
        covariance=np.zeros((len(c), len(c))),
    )
    return as_stage(fitted, robot)


def direction(v: Array) -> Array:
    return np.asarray(np.tanh(v / NARROW))


def bristles(distance: float, torque: float) -> Resists:
    """Dahl's bristles beside Coulomb friction, whose torque they pass on."""
    state = {"x": np.zeros(1)}

    def resists(q: Array, v: Array, load: Array) -> Array:
        state["x"] = state["x"] + 2.5e-4 * (v - np.abs(v) * state["x"]) / distance
        return np.asarray(torque * (state["x"] - direction(v)))

    return resists


EFFECTS: dict[str, tuple[EffectOfJoint, Callable[[], Resists]]] = {
    "stribeck": (
        effect("stribeck", [0.5], {"stribeck_speed": 0.1, "exponent": 1.0}),
        lambda: lambda q, v, load: 0.5 * np.exp(-np.abs(v) / 0.1) * direction(v),
    ),
    "asymmetric_friction": (
        effect("asymmetric_friction", [0.4, 0.1]),
        lambda: lambda q, v, load: 0.4 * np.abs(direction(v)) + 0.1 * np.abs(v),
    ),
    "position_dependent_friction": (
        effect(
            "position_dependent_friction",
            [0.15, 0.1],
            {"waves": 1.0, "period": 0.5},
        ),
        lambda: (
            lambda q, v, load: (
                (0.15 * np.cos(4.0 * np.pi * q) + 0.1 * np.sin(4.0 * np.pi * q))
                * direction(v)
            )
        ),
    ),
    "quadratic_drag": (
        effect("quadratic_drag", [0.6]),
        lambda: lambda q, v, load: 0.6 * v * np.abs(v),
    ),
    "spring": (
        effect("spring", [3.0, 0.5], {"cubic": 0.0}),
        lambda: lambda q, v, load: 3.0 * q + 0.5,
    ),
    "load_dependent_friction": (
        effect("load_dependent_friction", [0.2]),
        lambda: lambda q, v, load: 0.2 * np.abs(load) * direction(v),
    ),
    "presliding_hysteresis": (
        effect("presliding_hysteresis", [0.2], {"presliding_distance": 0.05}),
        lambda: bristles(0.05, 0.2),
    ),
}


def recorded(resists: Resists | None) -> Recording:
    return simulate_drive(
        soft_arm(),
        multisine(4, 1, SECONDS, highest_hz=2.0),
        SECONDS,
        seed=4,
        resists=resists,
    )


@cache
def of_plant(name: str) -> Recording:
    _, plant = EFFECTS[name]
    return recorded(plant())


def replayed(log: Recording, effects: list[EffectOfJoint]) -> ReplayFile:
    stages = structs.replace(soft_arm().stages(), effects=effects or None)
    return drives.replay([log], soft_arm().robot, true_drive(stages))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_a_replay_with_the_effect_is_closer_than_without(name: str) -> None:
    entry, _ = EFFECTS[name]
    log = replace(of_plant(name), tau=None)
    with_effect, without = (
        replayed(log, effects).joints["joint_1"].position.rms
        for effects in ([entry], [])
    )
    assert with_effect < 0.3 * without
    assert with_effect < 5e-4


@pytest.mark.slow
def test_a_torque_constant_is_put_right_before_the_comparison() -> None:
    true = recorded(None)
    assert true.tau is not None
    log = replace(true, tau=1.2 * true.tau)
    entry = effect("torque_constant", [0.2])
    with_effect, without = (
        replayed(log, effects).joints["joint_1"] for effects in ([entry], [])
    )
    assert with_effect.torque is not None
    assert without.torque is not None
    assert with_effect.torque.rms < 0.3 * without.torque.rms
    assert with_effect.position.rms == pytest.approx(without.position.rms, abs=1e-6)


def test_effects_that_cannot_take_part_are_named() -> None:
    entries = [
        effect("drift", [0.1, 0.0], {"duration": 10.0}),
        effect("torque_constant", [0.2]),
        effect("backlash", [0.01], {"trial_gap": 0.01}),
    ]
    stages = structs.replace(soft_arm().stages(), effects=entries)
    sorted_effects = arm_effects(stages, soft_arm().robot)
    accounted = len(sorted_effects.left_out) + len(sorted_effects.measured)
    assert accounted == len(entries)
    words = "\n".join(sorted_effects.left_out)
    assert "drift at joint_1 is not simulated" in words
    assert "backlash at joint_1 is not simulated" in words
    assert [item.effect.name for item in sorted_effects.measured] == ["torque_constant"]


@pytest.mark.parametrize("name", ["stribeck", "load_dependent_friction"])
def test_the_model_of_a_fit_without_a_torque_has_the_effect(name: str) -> None:
    entry, _ = EFFECTS[name]
    log = of_plant(name)
    assert log.tau is not None
    stages = structs.replace(soft_arm().stages(), effects=[entry])
    effects = arm_effects(stages, soft_arm().robot)
    model = effects.model
    measured = signals_of(log, model)
    left = {}
    for key, used in (("with", effects), ("without", None)):
        motion = signals_of(log, model, use_torque=False, effects=used)
        rows = motion.usable[:, 0] & (np.abs(motion.dq[:, 0]) > 0.1)
        left[key] = np.std((motion.torque - measured.torque)[rows, 0])
    assert left["with"] < 0.7 * left["without"]


def test_friction_by_the_load_that_windows_have_told_counts_once() -> None:
    entry, _ = EFFECTS["load_dependent_friction"]
    stages = structs.replace(soft_arm().stages(), effects=[entry])
    effects = arm_effects(stages, soft_arm().robot)
    assert [each.name for each in effects.of_steps(np.zeros(1))] == [entry.effect]
    assert not effects.of_steps(np.array([0.1]))
