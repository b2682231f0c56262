"""Effects of bodies: a payload, a base that leans, a spring beside gravity."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.discover.candidates import likeliest_log
from seqid_cli.discover.scenes import last_link_of
from seqid_cli.effects.base_tilt import (
    BaseTilt,
    first_joint_upright,
    first_link_moments,
    tilt_axes,
)
from seqid_cli.effects.measurement import MeasurementEffect
from seqid_cli.effects.payload import Payload
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.spring import Spring
from seqid_cli.params.schema import EffectOfJoint, Stages
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.effects.fitting import (
    Law,
    best_fitted,
    fitted,
    left_over,
    moved_by,
    rms_left,
    trials,
)
from tests.unit.effects.scenes import RATE_HZ, scene_of, wander

# kg, m
MASS = 2.5
AT = np.array([0.05, -0.1, 0.15])


def point_mass() -> Array:
    """Inertial parameters of a small body, about the flange's origin."""
    I = MASS * (AT @ AT * np.eye(3) - np.outer(AT, AT))
    return np.array(
        [MASS, *(MASS * AT), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]]
    )


def test_mass_moment_and_log_come_back() -> None:
    scenes = [scene_of(wander(15.0, seed=k), log=k) for k in range(3)]
    phi = scenes[2].model.phi + np.array([np.zeros(10), point_mass()])
    scenes[2] = moved_by(scenes[2], replace(scenes[2].model, phi=phi))
    rng = np.random.default_rng(0)
    residuals = [
        left_over(scene) + 1e-3 * rng.normal(size=scene.motion.q.shape)
        for scene in scenes
    ]
    settings = {"from_log": 2.0}
    assert likeliest_log(scenes, residuals, Payload(), None, {}) == 2
    assert likeliest_log(scenes[2:], residuals[2:], Payload(), None, {}) is None
    c, rms = fitted(Payload(), scenes, None, settings)
    visible = Payload().columns(scenes[2], None, settings)
    assert rms < 1e-6
    assert max(np.max(np.abs(X @ (c - point_mass()))) for X in visible.values()) < 1e-4
    assert c[1:3] == pytest.approx(MASS * AT[:2], abs=1e-3)


def test_the_lean_comes_back() -> None:
    """A true rotation of gravity by two degrees, of which the columns are the first
    order.
    """
    scene = scene_of(wander(15.0))
    axes = np.array(tilt_axes(scene.robot.gravity))
    lean = np.array([0.03, -0.02])
    turned = Rotation.from_rotvec(lean @ axes).apply(scene.robot.gravity)
    leaning = moved_by(
        scene, replace(scene.model, robot=replace(scene.robot, gravity=turned))
    )
    settings = {"upright": 0.0}
    c, rms = fitted(BaseTilt(), [leaning], None, settings)
    assert c == pytest.approx(lean, rel=0.05)
    assert rms < 0.05 * rms_left([leaning])
    for _ in range(3):
        settings = BaseTilt().sharpened(settings, c)
        c, rms = fitted(BaseTilt(), [leaning], None, settings)
    assert c == pytest.approx(lean, rel=1e-4)
    assert rms < 1e-5 * rms_left([leaning])


@pytest.mark.parametrize("around", [0.0, 0.5, -1.5, 2.9])
@pytest.mark.parametrize("joint", [0, 1])
def test_five_angles_tell_a_zero_at_any(joint: int, around: float) -> None:
    scene = scene_of(wander(5.0))
    motion = scene.motion
    low, high = (-0.5e-3, 0.5e-3) if around == 0.0 else (0.0, around)
    turn = np.eye(2)[joint]
    ahead = scene.model.rigid(motion.q + high * turn, motion.dq, motion.ddq)
    behind = scene.model.rigid(motion.q + low * turn, motion.dq, motion.ddq)
    slope = (ahead - behind) / (high - low)
    columns = CATALOGUE["joint_zero"].columns(scene, joint, {"around": around})
    found = np.hstack([columns[j] for j in range(2)])
    np.testing.assert_allclose(found, slope, atol=1e-5 * np.max(np.abs(slope)))


@pytest.mark.parametrize(("joint", "angle"), [(0, 0.03), (1, -0.04), (1, 0.8)])
def test_the_error_of_a_zero_comes_back(joint: int, angle: float) -> None:
    """The log has positions that are too small by it, and torque of the true ones."""
    true = scene_of(wander(15.0))
    q = true.motion.q - angle * np.eye(2)[joint]
    logged = scene_of(q)
    logged = replace(logged, motion=replace(logged.motion, tau=true.motion.tau))
    effect = CATALOGUE["joint_zero"]
    settings, c, rms = best_fitted(effect, [logged], joint)
    assert c[0] == pytest.approx(angle, rel=0.02)
    assert settings["around"] == pytest.approx(angle, rel=0.05)
    # Friction over the position stays where it was, which is what is left.
    assert rms < 0.03 * rms_left([logged])
    assert isinstance(effect, MeasurementEffect)
    recording = made_recording(q, rate_hz=RATE_HZ)
    freed = effect.restored(recording, logged.robot, joint, settings, np.array([angle]))
    np.testing.assert_allclose(freed.q, true.motion.q, atol=1e-12)


def test_another_joints_zero_leaves_more() -> None:
    true = scene_of(wander(15.0))
    logged = scene_of(true.motion.q - np.array([0.0, 0.05]))
    logged = replace(logged, motion=replace(logged.motion, tau=true.motion.tau))
    left = [best_fitted(CATALOGUE["joint_zero"], [logged], j).rms for j in (0, 1)]
    assert left[0] > 3.0 * left[1]


# A kilogram that is spread by 0.1 m about the flange's origin.
HULL = np.array([1.0, 0.0, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02])
ERRORS = np.array([0.05, *[0.01] * 3, *[0.004] * 6])  # kg, kg m, kg m^2


@pytest.mark.parametrize(
    ("phi", "exists"),
    [
        (point_mass(), True),
        # within its errors
        (point_mass() + ERRORS * np.array([1, -1, 1, 1, -1, 1, -1, 1, -1, 1]), True),
        # minus a body; a moment without a mass
        (-point_mass(), False),
        (np.array([0.0, 0.3, *[0.0] * 8]), False),
        # an inertia that no body of this mass and centre has
        (point_mass() - np.array([*[0.0] * 4, 0.5, 0.0, 0.5, 0.0, 0.0, 0.5]), False),
    ],
)
def test_a_payload_is_a_body(phi: Array, exists: bool) -> None:
    scenes = [scene_of(wander(3.0))]
    assert Payload().can_exist(scenes, phi, np.diag(ERRORS**2)) == exists


@pytest.mark.parametrize(
    ("carried", "exists"),
    [
        # as heavy as what is gone, and heavier
        (1.0, True),
        (2.0, True),
        # too light; or nothing says what the last link carries
        (0.2, False),
        (None, False),
    ],
)
def test_a_tool_that_is_gone_was_there(carried: float | None, exists: bool) -> None:
    scene = scene_of(wander(3.0))
    if carried is not None:
        scene = replace(scene, last_link=0.05 * HULL + carried * point_mass())
    gone = -point_mass()
    assert Payload().can_exist([scene], gone, np.diag(ERRORS**2)) == exists


def test_what_is_gone_was_a_body() -> None:
    """However heavy the last link is: a moment without a mass is none."""
    scene = replace(scene_of(wander(3.0)), last_link=100.0 * HULL)
    moment = np.array([0.0, 0.3, *[0.0] * 8])
    assert not Payload().can_exist([scene], moment, np.diag(ERRORS**2))


def test_the_last_link_is_that_of_the_urdf_with_the_payloads_of_the_file() -> None:
    robot = two_joint_robot()
    bare = replace(robot, nominal=None)
    urdf = replace(robot, nominal=np.array([0.0 * HULL, HULL]))
    payload = EffectOfJoint(effect="payload", coefficients=point_mass().tolist())
    file = Stages(effects=[EffectOfJoint(effect="base_tilt"), payload])
    assert last_link_of(bare, Stages()) is None
    np.testing.assert_allclose(last_link_of(urdf, Stages()), HULL)
    np.testing.assert_allclose(last_link_of(bare, file), point_mass())
    np.testing.assert_allclose(last_link_of(urdf, file), HULL + point_mass())


def test_what_is_not_known_of_a_payload_is_not_held_against_it() -> None:
    """Mass and centre of one that only swings about the last axis stay open."""
    scenes = [scene_of(wander(3.0))]
    covariance = np.diag(np.where(ERRORS < 0.02, ERRORS, 3.0) ** 2)
    phi = point_mass()
    phi[0] = 0.0
    assert Payload().can_exist(scenes, phi, covariance)


def test_a_payload_is_within_reach() -> None:
    """Its inertia is not known, its mass and its moment are."""
    scenes = [scene_of(wander(3.0))]
    covariance = np.diag(np.concatenate([ERRORS[:4], np.full(6, 30.0)]) ** 2)
    for out, exists in ((0.5, True), (7.0, False)):
        phi = np.array([0.3, 0.3 * out, *[0.0] * 8])
        assert Payload().can_exist(scenes, phi, covariance) == exists


def upright_robot() -> Robot:
    """The two-joint arm with gravity along its first axis."""
    robot = two_joint_robot()
    return replace(robot, gravity=-9.81 * robot.chain.rotation[0] @ robot.chain.axis[0])


def test_the_first_links_moment_shows_once_its_axis_leans() -> None:
    """Oracle: the rigid body with that moment, with gravity turned, less the same
    upright.
    """
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 2))
    robot = upright_robot()
    assert first_joint_upright(robot)
    still = np.zeros_like(q)
    phi = np.zeros((2, 10))
    phi[0, 1:4] = [0.7, -0.4, 0.2]
    lean = 0.02 * tilt_axes(robot.gravity)[0]
    across = np.cross(lean, robot.gravity)
    torque = inverse_dynamics(robot.chain, across, phi, q, still, still)
    X = first_link_moments(robot, across, q)
    c, squares = np.linalg.lstsq(X, torque[:, 0], rcond=None)[:2]
    assert squares.sum() < 1e-20
    assert np.linalg.norm(c) > 0
    upright = inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still)
    np.testing.assert_allclose(upright, 0.0, atol=1e-12)


def test_moments_without_a_tilt_are_none() -> None:
    """Of the first link alone they are any function of its angle."""
    scene = scene_of(wander(5.0), robot=upright_robot())
    for tilt, believed in ((0.02, True), (1e-5, False)):
        c = np.array([tilt, 0.0, 0.3, 0.0])
        assert BaseTilt().plausible([scene], None, {"upright": 1.0}, c) == believed


# N m/rad, rad, N m/rad^3
K = 12.0
REST = 0.3
CUBIC = 4.0


def of_energy(energy: Callable[[Array], Array]) -> Law:
    """Return the first joint's torque: the slope of an energy of its angle."""
    return lambda t, q, dq: (
        (energy(q + 1e-4) - energy(q - 1e-4)) / 2e-4 * np.array([1.0, 0.0])
    )


@pytest.mark.parametrize("cubic", [0.0, 1.0])
def test_stiffness_and_rest_come_back(cubic: float) -> None:
    scenes = trials(of_energy(lambda q: 0.5 * K * (q - REST) ** 2))
    c, rms = fitted(Spring(), scenes, 0, {"cubic": cubic})
    values = Spring().values(
        scenes[0].robot, 0, {"cubic": cubic}, c, 1e-4 * np.eye(len(c))
    )
    assert values[0].value == pytest.approx(K, rel=0.01)
    assert values[1].value == pytest.approx(REST, abs=0.01)
    assert values[1].std_error == pytest.approx(
        1e-2 / K * np.hypot(1.0, REST), rel=0.05
    )
    assert rms < 0.05


def test_a_stiffening_cable_needs_the_cube() -> None:
    scenes = trials(of_energy(lambda q: K * q**2 / 2.0 + CUBIC * q**4 / 4.0))
    settings, c, _ = best_fitted(Spring(), scenes, 0)
    assert settings == {"cubic": 1.0}
    assert c[0] == pytest.approx(K, rel=0.02)
    assert c[2] == pytest.approx(CUBIC, rel=0.03)
    assert c[3] == pytest.approx(0.0, abs=0.1)


def test_a_spring_between_two_points_pulls_otherwise_on_either_side() -> None:
    """A coil spring from a point 0.3 m off the axis to one 0.25 m off, on the link."""

    def energy(q: Array) -> Array:
        length = np.sqrt(0.3**2 + 0.25**2 - 2 * 0.3 * 0.25 * np.cos(q + 0.5))
        return np.asarray(0.5 * 1500.0 * (length - 0.03) ** 2)

    scenes = trials(of_energy(energy))
    settings, c, rms = best_fitted(Spring(), scenes, 0)
    _, linear = fitted(Spring(), scenes, 0, {"cubic": 0.0})
    assert settings == {"cubic": 1.0}
    assert abs(c[3]) > 5.0
    assert rms < 0.3 * linear
