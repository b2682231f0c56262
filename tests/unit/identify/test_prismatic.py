"""A vertical slide with a pendulum on it goes through friction, gravity and inertia."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.types import Chain, Joint, Robot
from tests import Array
from tests.plants.motions.trajectories import Reference, hold, join, sweeps, together, zigzag
from tests.plants.robots.made import made_recording
from tests.plants.robots.sample import rmse
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


def record(name: str, reference: Reference, rng: np.random.Generator) -> Recording:
    samples = len(reference.q)
    return made_recording(
        quantise(reference.q, STEPS),
        load(reference) + NOISE * rng.standard_normal((samples, 2)),
        rate_hz=RATE,
        path=name,
    )


def both(rng: np.random.Generator, seconds: float) -> Reference:
    moving = {
        j: zigzag(
            rng,
            (float(LIMITS[j, 0]), float(LIMITS[j, 1])),
            float(TOP[j]),
            float(ACCELERATION[j]),
            seconds,
            RATE,
        )
        for j in (0, 1)
    }
    motion = together(LIMITS.mean(axis=1), moving, RATE)
    return join([hold(motion.q[0], 0.5, RATE), motion])


@dataclass(frozen=True)
class Identified:
    """The three stages, each when first asked for."""

    robot: Robot

    @cached_property
    def single(self) -> list[Recording]:
        rng = np.random.default_rng(0)
        logs = []
        for j in (0, 1):
            pace = [float(v) for v in np.geomspace(0.1, 1.0, 6) * TOP[j]]
            for number, angle in enumerate((-1.2, 0.9) if j == 0 else (0.3,)):
                home = np.array([0.4, angle])
                span = (float(LIMITS[j, 0]), float(LIMITS[j, 1]))
                motion = sweeps(home, j, span, pace, float(ACCELERATION[j]), rate_hz=RATE)
                logs.append(record(f"joint_{j}_{number}", motion, rng))
        return logs

    @cached_property
    def friction(self) -> FrictionStage:
        return identify_friction(self.single, self.robot, options=FrictionOptions())

    @cached_property
    def gravity(self) -> RigidStage:
        stages = Stages(friction=self.friction)
        return identify_gravity(self.single, self.robot, stages)

    @cached_property
    def inertia(self) -> RigidStage:
        log = record("both", both(np.random.default_rng(1), 20.0), np.random.default_rng(2))
        stages = Stages(friction=self.friction, gravity=self.gravity)
        return identify_inertia([log], self.robot, stages, options=InertiaOptions())


TRUE = {
    "m_1": SLIDE,
    "m_2": ARM,
    "mx_2": MX,
    "my_2": 0.0,
    "mz_2": MZ,
    "Iyy_2": INERTIA,
}


def true_value(terms: dict[str, float]) -> float:
    return sum(factor * TRUE[name] for name, factor in terms.items())


@pytest.fixture(scope="module")
def identified() -> Identified:
    return Identified(slider())


def test_the_plant_is_the_packages_inverse_dynamics() -> None:
    """The equations above, from another source: Newton-Euler of the chain."""
    from seqid_cli.robot.regressor import inverse_dynamics

    motion = both(np.random.default_rng(3), 2.0)
    phi = np.zeros((2, 10))
    phi[0, 0] = SLIDE
    phi[1, [0, 1, 3, 6]] = ARM, MX, MZ, INERTIA
    robot = slider()
    tau = inverse_dynamics(robot.chain, robot.gravity, phi, motion.q, motion.dq, motion.ddq)
    friction = DRY * np.sign(motion.dq) + VISCOUS * motion.dq
    np.testing.assert_allclose(tau + friction, load(motion), atol=1e-9)


def test_friction_of_slide_and_pendulum(identified: Identified) -> None:
    assert identified.friction.joints["lift"].unit == "N"
    assert identified.friction.joints["swing"].unit == "N m"
    for j, name in enumerate(("lift", "swing")):
        joint = identified.friction.joints[name]
        assert not joint.directional
        surface = FrictionSurface.from_stage(joint)
        speed = np.linspace(*surface.scaling.speed, 30)
        middle = np.full(30, LIMITS[j].mean())
        true = DRY[j] + VISCOUS[j] * speed
        for sign in (1, -1):
            np.testing.assert_allclose(sign * surface.torque(middle, sign * speed), true, rtol=0.02)


def test_the_weight_on_the_slide_is_its_p_xi(identified: Identified) -> None:
    for group in identified.friction.joints["lift"].gravity:
        (mass,), (error,) = group.p_xi, group.std_error
        assert abs(mass - SLIDE - ARM) < max(4 * error, 0.01)


def test_gravity_parameters(identified: Identified) -> None:
    stage = identified.gravity
    assert stage.not_excited == []
    assert {p.unit for p in stage.parameters} == {"kg", "kg m"}
    for p in stage.parameters:
        true = true_value(p.terms)
        assert abs(p.value - true) < 4 * p.std_error, p.name
        assert p.value == pytest.approx(true, rel=0.01), p.name


def test_inertia_parameters(identified: Identified) -> None:
    stage = identified.inertia
    assert stage.rank == stage.structural_rank == 4
    (p,) = stage.parameters
    assert p.name == "Iyy_2"
    assert p.value == pytest.approx(INERTIA, rel=0.01)
    assert abs(p.value - INERTIA) < 4 * p.std_error


def test_prediction_of_a_new_motion(identified: Identified) -> None:
    stages = Stages(
        friction=identified.friction, gravity=identified.gravity, inertia=identified.inertia
    )
    log = record("new", both(np.random.default_rng(5), 10.0), np.random.default_rng(6))
    (found,) = predict([log], identified.robot, stages, options=InertiaOptions())
    size = found.tau[found.used].std(axis=0)
    assert (rmse([found]) < 0.05 * size).all()
