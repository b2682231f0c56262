"""A vertical slide with a pendulum on it goes through friction, gravity and inertia."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Chain, Joint, Robot
from tests import Array
from tests.plants.motions.trajectories import Reference, hold, join, sweeps, together, zigzag
from tests.plants.robots.made import made_recording
from tests.plants.sensors import quantise

pytestmark = pytest.mark.slow


RATE = 250.0
G = 9.81
SLIDE, ARM = 8.0, 3.0  # masses, kg
MX, MZ, INERTIA = 0.6, 0.25, 0.21  # pendulum: first moments kg m, inertia about its axis kg m^2
DRY, VISCOUS = np.array([30.0, 0.8]), np.array([60.0, 0.3])
NOISE = np.array([2.0, 0.05])  # N, N m
STEPS = np.array([5e-6, 2 * np.pi / 2**16])  # m, rad
LIMITS = np.array([[0.05, 0.75], [-2.2, 2.2]])
TOP, ACCELERATION = np.array([0.5, 3.0]), np.array([4.0, 20.0])


def slider() -> Robot:
    """Joint 1 slides up; joint 2 turns about -y, so that x of its link rises with q_2."""
    chain = Chain(
        rotation=np.tile(np.eye(3), (2, 1, 1)),
        position=np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]]),
        axis=np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        prismatic=np.array([True, False]),
    )
    joints = (
        Joint("lift", prismatic=True, rotor_inertia=0.0),
        Joint("swing", rotor_inertia=0.0),
    )
    gravity = np.array([0.0, 0.0, -G])
    return Robot("slider", joints, chain, gravity, "0" * 64, Path("robot.toml"))


def load(reference: Reference) -> Array:
    """Lagrange's equations of the slide and the pendulum, friction added, (N, 2) N and N m.

    Height of the pendulum's centre over the slide: (mx sin q + mz cos q) / m.
    """
    q, dq, ddq = reference.q[:, 1], reference.dq, reference.ddq
    s, c = np.sin(q), np.cos(q)
    lever = MX * c - MZ * s  # derivative of the height's moment
    bend = -MX * s - MZ * c
    force = (SLIDE + ARM) * (ddq[:, 0] + G) + lever * ddq[:, 1] + bend * dq[:, 1] ** 2
    torque = INERTIA * ddq[:, 1] + lever * (ddq[:, 0] + G)
    friction = DRY * np.sign(dq) + VISCOUS * dq
    return np.column_stack([force, torque]) + friction


def record(reference: Reference, seed: int) -> Recording:
    noise = NOISE * np.random.default_rng(seed).standard_normal(reference.q.shape)
    return made_recording(quantise(reference.q, STEPS), load(reference) + noise, rate_hz=RATE)


def single() -> list[Recording]:
    """Moves of one joint at a time, the slide with the pendulum in two postures."""
    logs = []
    for j, angle in ((0, -1.2), (0, 0.9), (1, 0.3)):
        pace = (np.geomspace(0.1, 1.0, 6) * TOP[j]).tolist()
        low, high = LIMITS[j].tolist()
        home = np.array([0.4, angle])
        motion = sweeps(home, j, (low, high), pace, float(ACCELERATION[j]), rate_hz=RATE)
        logs.append(record(motion, len(logs)))
    return logs


def both(seed: int, seconds: float) -> Recording:
    rng, moving = np.random.default_rng(seed), {}
    for j in (0, 1):
        low, high = LIMITS[j].tolist()
        limits = float(TOP[j]), float(ACCELERATION[j])
        moving[j] = zigzag(rng, (low, high), *limits, seconds, RATE)
    motion = together(LIMITS.mean(axis=1), moving, RATE)
    return record(join([hold(motion.q[0], 0.5, RATE), motion]), seed + 1)


@pytest.fixture(scope="module")
def stages() -> Stages:
    found, robot, logs = Stages(), slider(), single()
    found.friction = identify_friction(logs, robot, options=FrictionOptions())
    found.gravity = identify_gravity(logs, robot, found)
    found.inertia = identify_inertia([both(1, 20.0)], robot, found, options=InertiaOptions())
    return found


TRUE = {"m_1": SLIDE, "m_2": ARM, "mx_2": MX, "my_2": 0.0, "mz_2": MZ, "Iyy_2": INERTIA}


def test_friction_of_slide_and_pendulum(stages: Stages) -> None:
    joints = stages.friction.joints
    assert [joint.unit for joint in joints.values()] == ["N", "N m"]
    for j, joint in enumerate(joints.values()):
        assert not joint.directional
        surface = FrictionSurface.from_stage(joint)
        speed = np.linspace(*surface.scaling.speed, 30)
        middle = np.full(30, LIMITS[j].mean())
        true = DRY[j] + VISCOUS[j] * speed
        for sign in (1, -1):
            np.testing.assert_allclose(sign * surface.torque(middle, sign * speed), true, rtol=0.02)


def test_gravity_and_inertia_are_the_true_ones(stages: Stages) -> None:
    """Equations of the plant and of the package are not of one source: Lagrange, Newton-Euler."""
    gravity, inertia = stages.gravity, stages.inertia
    assert gravity.not_excited == []
    assert {p.unit for p in gravity.parameters} == {"kg", "kg m"}
    assert inertia.rank == inertia.structural_rank == 4
    assert [p.name for p in inertia.parameters] == ["Iyy_2"]
    for p in (*gravity.parameters, *inertia.parameters):
        true = sum(factor * TRUE[name] for name, factor in p.terms.items())
        assert abs(p.value - true) < 4 * p.std_error, p.name
        assert p.value == pytest.approx(true, rel=0.01), p.name
