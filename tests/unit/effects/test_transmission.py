"""What lies between motor and link: a spring, play, rotors, an encoder, a drive of two
joints.
"""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from seqid_cli.effects.backlash import Backlash
from seqid_cli.effects.encoder_eccentricity import EncoderEccentricity
from seqid_cli.effects.gear_efficiency import GearEfficiency
from seqid_cli.effects.gear_load import LoadLoss, smallest_inertia
from seqid_cli.effects.joint_elasticity import JointElasticity
from seqid_cli.effects.load_dependent_friction import LoadDependentFriction
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.rotor_inertia import RotorInertia
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.transmission_coupling import TransmissionCoupling
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.robot.base_parameters import STANDARD
from tests import Array
from tests.plants.robots.two_joint import GEAR, ROTOR, SIGN_WIDTH, two_joint_robot
from tests.unit.effects.fitting import (
    FINE_HZ,
    Law,
    best_fitted,
    fitted,
    moved_by,
    rms_left,
    trials,
)
from tests.unit.effects.scenes import RATE_HZ, motion_of, scene_of, wander
from tests.unit.effects.two_mass import Gear, run, scene

STIFFNESS = 4000.0  # N m/rad; resonance with the motor held: 11 Hz


@pytest.mark.parametrize("cutoff_hz", [5.0, 20.0])
@pytest.mark.parametrize("side", ["motor", "link"])
def test_the_stiffness_comes_back(
    cutoff_hz: float, side: Literal["motor", "link"]
) -> None:
    """Also with the resonance inside the band; the robot file tells where the encoder
    sits.
    """
    effect = JointElasticity()
    logs = [run(Gear(STIFFNESS, 2.0), seed=seed) for seed in range(2)]
    scenes = [scene(log, cutoff_hz=cutoff_hz, side=side) for log in logs]
    settings, c, rms = best_fitted(effect, scenes, 0)
    value = effect.values(scenes[0].robot, 0, settings, c, np.array([[1e-14]]))[0]
    assert settings["encoder_side"] == (side == "link")
    assert value.value == pytest.approx(STIFFNESS, rel=0.06)
    assert value.std_error == pytest.approx(1e-7 * value.value**2)
    assert rms < 0.4 * rms_left(scenes)


@pytest.mark.parametrize("cutoff_hz", [10.0, 20.0])
@pytest.mark.parametrize("gap", [1e-3, pytest.param(4e-3, marks=pytest.mark.slow)])
def test_the_gap_comes_back(gap: float, cutoff_hz: float) -> None:
    """One column takes more than nine tenths of what play does; an elastic gear does
    not.
    """
    logs = [run(Gear(5e4, 20.0, gap), seed=seed) for seed in range(2)]
    scenes = [scene(log, cutoff_hz=cutoff_hz) for log in logs]
    _, c, rms = best_fitted(Backlash(), scenes, 0)
    assert c[0] == pytest.approx(gap, rel=0.2)
    assert rms < 0.3 * rms_left(scenes)
    elastic = JointElasticity()
    rival = min(fitted(elastic, scenes, 0, s)[1] for s in elastic.grid(scenes, 0, []))
    assert rival > 2.0 * rms


SOFT = {"trial_stiffness": 900.0, "encoder_side": 0.0, "damping_ratio": 0.15}


@pytest.mark.parametrize(
    ("name", "settings"),
    [("joint_elasticity", SOFT), ("backlash", {"trial_gap": 1e-3})],
)
def test_values_are_stated_where_a_rotor_is_known_apart_from_its_link(
    name: str, settings: dict[str, float]
) -> None:
    """The first joint turns both alike in every motion; of the second it depends on the
    arm.
    """
    effect = CATALOGUE[name]
    with_rotors = two_joint_robot()
    c = np.array([1e-3])
    (value,) = effect.reported(with_rotors, 0, settings, c, np.eye(1))
    assert value.value > 0.0
    assert not effect.lacking(with_rotors, 0)
    without_rotors = replace(
        with_rotors,
        joints=tuple(replace(x, rotor_inertia=None) for x in with_rotors.joints),
    )
    assert effect.reported(without_rotors, 0, settings, c, np.eye(1)) == []
    for part in ("rotor_inertia", without_rotors.joint_names[0]):
        assert part in effect.lacking(without_rotors, 0)
    assert effect.reported(without_rotors, 1, settings, c, np.eye(1))


def with_rotor_of_the_link(scene: Scene, joint: int, inertia: float) -> Scene:
    """Let the model take an inertia (kg m^2) of a link for that of its rotor."""
    of_sphere = np.zeros_like(scene.model.phi)
    diagonal = [STANDARD.index(name) for name in ("Ixx", "Iyy", "Izz")]
    of_sphere[joint, diagonal] = inertia
    motor_side = inertia * np.eye(scene.robot.n)[joint] / scene.gear**2
    model = replace(
        scene.model,
        phi=scene.model.phi - of_sphere,
        rotor=scene.model.rotor + motor_side,
    )
    return replace(scene, model=model)


@pytest.mark.parametrize("effect", [GearEfficiency(), LoadDependentFriction()])
def test_losses_do_not_depend_on_what_a_file_takes_for_the_rotor(
    effect: LoadLoss,
) -> None:
    """A file that was identified with the losses inside has made a rotor of them."""
    joint = 1
    right = scene_of(wander(8.0, still=[0], amplitude=0.6))
    wrong = with_rotor_of_the_link(right, joint, 0.5)
    settings = {"reflected_rotor_inertia": float(right.rotor[joint])}
    expected = effect.columns(right, joint, {})[joint]
    assert np.std(effect.columns(wrong, joint, {})[joint] - expected) > 0.1
    np.testing.assert_allclose(
        effect.columns(wrong, joint, settings)[joint], expected, atol=1e-9
    )


def test_rotors_are_searched_where_the_file_hardly_knows_them() -> None:
    effect = GearEfficiency()
    (plain,) = [scene_of(wander(4.0))]
    joints = tuple(replace(x, rotor_inertia=None) for x in plain.robot.joints)
    without_rotors = replace(plain, robot=replace(plain.robot, joints=joints))
    inertia = smallest_inertia([without_rotors], 1)

    def tried(share: float) -> list[float]:
        std = np.array([np.inf, share * inertia / plain.gear[1] ** 2])
        model = replace(plain.model, rotor_std=std)
        scene = replace(without_rotors, model=model)
        grid = effect.grid([scene], 1, [])
        return [x.get("reflected_rotor_inertia", 0.0) / inertia for x in grid]

    assert tried(0.001) == [0.0]
    assert max(tried(0.3)) == pytest.approx(0.6)


ERROR = 3e-5  # kg m^2, of a rotor


@pytest.mark.parametrize("joint", [0, 1])
def test_the_missing_inertia_comes_back(joint: int) -> None:
    plain = scene_of(wander(10.0))
    heavier = replace(plain.model, rotor=np.array(ROTOR) + ERROR * np.eye(2)[joint])
    c, rms = fitted(
        RotorInertia(), [moved_by(plain, heavier)], joint, {"coupling": 0.0}
    )
    assert c[0] == pytest.approx(ERROR, rel=1e-6)
    assert rms < 1e-9


def test_the_spin_of_a_carried_rotor_comes_back() -> None:
    """Angular momentum of the spin about the base's z, differentiated numerically."""
    plain = scene_of(wander(10.0))
    turning = replace(plain.model, rotor=np.array(ROTOR), coupling="gyroscopic")
    c, rms = fitted(RotorInertia(), [moved_by(plain, turning)], 1, {"coupling": 1.0})
    assert c[0] == pytest.approx(ROTOR[1], rel=1e-6)
    assert rms < 1e-9
    motion = plain.motion
    chain = plain.robot.chain
    along = (chain.rotation[1] @ chain.axis[1])[2]  # link 1 turns about the base's z
    moment = np.gradient(GEAR[1] * motion.dq[:, 1] * along, 1.0 / motion.rate_hz)
    column = RotorInertia().columns(plain, 1, {"coupling": 1.0})[0][:, 0]
    np.testing.assert_allclose(
        column[50:-50], moment[50:-50], atol=0.01 * np.ptp(moment)
    )


# rad at the joint: 6 and 4.5 mrad at the motor
SIN = 1.2e-4
COS = -0.9e-4


def misread(order: float, seed: int) -> Scene:
    """Torque of the true motion, slow enough for a ripple per motor turn to pass the
    low-pass.
    """
    q = wander(
        24.0, seed=seed, rate_hz=4 * RATE_HZ, rests=(), amplitude=0.3, top_hz=0.3
    )
    dq, ddq = differentiate(q, 4 * RATE_HZ)
    plain = scene_of(q[::4])
    tau = plain.model.rigid(q, dq, ddq) + plain.model.friction(q, dq)
    p = order * GEAR[1] * q[:, 1]
    read = q + np.outer(SIN * np.sin(p) + COS * np.cos(p), [0.0, 1.0])
    return replace(plain, motion=motion_of(read[::4], tau=tau[::4]))


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_error_and_order_of_an_encoder_come_back(order: float) -> None:
    scenes = [misread(order, seed) for seed in (3, 4)]
    settings, c, rms = best_fitted(EncoderEccentricity(), scenes, 1)
    assert settings == {"order": order}
    assert c == pytest.approx([SIN, COS], rel=0.15)
    assert rms < 0.5 * rms_left(scenes)
    values = EncoderEccentricity().values(
        scenes[0].robot, 1, settings, c, 1e-12 * np.eye(2)
    )
    assert values[0].value == pytest.approx(np.hypot(SIN, COS), rel=0.15)
    assert values[1].value == pytest.approx(np.arctan2(COS, SIN), abs=0.1)
    assert values[0].std_error == pytest.approx(1e-6)


# of a motor that turns with two joints
COULOMB = 2.1
VISCOUS = 0.6
INERTIA = 0.05


def friction_and_inertia(rate: Array) -> Array:
    change = np.gradient(rate, 1.0 / FINE_HZ)
    return COULOMB * np.tanh(rate / SIGN_WIDTH) + VISCOUS * rate + INERTIA * change


def with_both(ratio: float) -> Law:
    """Power of the motor's friction and inertia, shared out as its rate is; else on
    joint 1.
    """

    def law(t: Array, q: Array, dq: Array) -> Array:
        torque = friction_and_inertia(dq[:, 0] + ratio * dq[:, 1])
        return np.stack(
            [torque - friction_and_inertia(dq[:, 0]), ratio * torque], axis=1
        )

    return law


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.3, -0.3])
def test_friction_and_inertia_of_the_motor_come_back(ratio: float) -> None:
    scenes = trials(with_both(ratio))
    c, rms = fitted(
        TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "ratio": ratio}
    )
    assert c == pytest.approx([COULOMB, VISCOUS, INERTIA], rel=0.05)
    assert rms < 0.1
    wrong = fitted(
        TransmissionCoupling(), scenes, 0, {"neighbour": 1.0, "ratio": -ratio}
    )[1]
    assert wrong > 5 * rms


def test_both_neighbours_are_tried() -> None:
    """Ratios between a slide and a turn are in units of their top speeds."""
    turning = scene_of(wander(20.0, seed=4, rests=()))
    effect = TransmissionCoupling()
    grids = [(j, s) for j in (0, 1) for s in effect.grid([turning], j, [])]
    offered = [(j, s["neighbour"]) for j, s in grids if s["ratio"] == 1.0]
    assert offered == [(0, 1.0), (1, -1.0)]
    q = wander(20.0, seed=4, rests=()) * np.array([1.0, 0.05])
    screw = scene_of(q, robot=two_joint_robot(prismatic=True))
    top = np.max(np.abs(screw.motion.dq), axis=0)
    of_slide = [settings["ratio"] for settings in effect.grid([screw], 1, [])]
    of_turn = [settings["ratio"] for settings in effect.grid([screw], 0, [])]
    assert max(of_slide) == pytest.approx(top[1] / top[0])
    assert max(of_slide) < 0.2
    assert 1 / max(of_slide) in [pytest.approx(ratio) for ratio in of_turn]


def test_nobody_can_say_what_a_drive_that_sticks_has() -> None:
    """Though both joints move: there is no friction of the one drive that both have."""
    slow = wander(20.0, seed=4, rests=())[:, :1]
    q = np.hstack([slow, -slow])
    middle = len(q) // 2
    q[middle:, 1] *= -1.0
    guessed = TransmissionCoupling().guessed(
        scene_of(q), 1, {"neighbour": -1.0, "ratio": 1.0}
    )
    assert sorted(guessed) == [0, 1]
    assert guessed[0][200 : middle - 200].all()
    assert 0.0 < guessed[1][middle + 200 :].mean() < 0.6
    np.testing.assert_array_equal(guessed[0], guessed[1])
