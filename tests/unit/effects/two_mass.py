"""A motor and a pendulum with a gear between them that gives or has play, in small time
steps.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from seqid_cli.effects.scene import Scene
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import decimated
from seqid_cli.robot.kinematics import chain_from_dh
from tests import Array
from tests.plants.robots.small import robot_from_chain
from tests.plants.robots.two_joint import SIGN_WIDTH, friction_surface
from tests.unit.effects.scenes import motion_of

# kg m^2 at the joint
MOTOR = 0.4
LINK = 0.8
WEIGHT = 8.0  # N m, of the level link
COULOMB = 3.0
VISCOUS = 1.0
STEP_S = 2e-5
LOG_HZ = 1000.0


@dataclass(frozen=True)
class Gear:
    """Stiffness [N m/rad], damping [N m s/rad] and gap [rad] of the gear."""

    stiffness: float
    damping: float
    gap: float = 0.0

    def torque(self, lead: float, rate: float) -> float:
        """Return the torque on the link, N m.

        Where there is play, flanks push and do not pull.
        """
        if self.gap == 0.0:
            return self.stiffness * lead + self.damping * rate
        side = math.copysign(1.0, lead)
        depth = abs(lead) - 0.5 * self.gap
        if depth <= 0.0:
            return 0.0
        flank = self.stiffness * depth + side * self.damping * rate
        return side * max(0.0, flank)


class Log(NamedTuple):
    """Angles of motor and link (N,) rad, motor torque (N,) N m."""

    motor: Array
    link: Array
    torque: Array


@cache
def run(gear: Gear, *, seed: int = 0, seconds: float = 8.0) -> Log:
    """Follow a sum of sines; logged in the middle of each control period."""
    period = round(1 / (LOG_HZ * STEP_S))
    plan = _plan(seed, round(seconds / STEP_S))
    angle, speed, _ = next(plan)
    link = angle
    link_speed = speed
    motor = angle + WEIGHT * math.sin(angle) / gear.stiffness
    motor_speed = speed
    command = 0.0

    rows = []
    for k, (wanted, rate, acceleration) in enumerate(plan):
        # The controller knows the arm, but not the gear.
        if k % period == 0:
            friction = COULOMB * math.tanh(rate / SIGN_WIDTH) + VISCOUS * rate
            inertial = (MOTOR + LINK) * acceleration
            modelled = inertial + WEIGHT * math.sin(wanted) + friction
            feedback = 3000 * (wanted - motor) + 70 * (rate - motor_speed)
            command = feedback + modelled
        if k % period == period // 2:
            rows.append((motor, link, command))

        passed = gear.torque(motor - link, motor_speed - link_speed)
        friction = COULOMB * math.tanh(motor_speed / SIGN_WIDTH)
        friction += VISCOUS * motor_speed
        motor_speed += STEP_S * (command - passed - friction) / MOTOR
        link_speed += STEP_S * (passed - WEIGHT * math.sin(link)) / LINK
        motor += STEP_S * motor_speed
        link += STEP_S * link_speed
    logged = np.array(rows)
    return Log(motor=logged[:, 0], link=logged[:, 1], torque=logged[:, 2])


def _plan(seed: int, steps: int) -> Iterator[tuple[float, float, float]]:
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.2, 2.0, 5)[:, None]
    weight = rng.normal(size=(5, 1)) / omega
    weight *= 0.6 / np.linalg.norm(weight)
    phase = omega * np.arange(steps) * STEP_S + rng.uniform(0, 2 * np.pi, (5, 1))
    angle = np.sum(weight * np.sin(phase), axis=0)
    speed = np.sum(weight * omega * np.cos(phase), axis=0)
    acceleration = -np.sum(weight * omega**2 * np.sin(phase), axis=0)
    return zip(angle.tolist(), speed.tolist(), acceleration.tolist(), strict=True)


def scene(
    log: Log,
    *,
    cutoff_hz: float,
    side: Literal["motor", "link"] = "motor",
    noise: float = 0.03,
) -> Scene:
    """Return the log as the model of an arm without the gear sees it.

    Encoder counts are of 1e-5 rad.
    """
    angle = log.motor if side == "motor" else log.link
    counts = np.round(angle / 1e-5)[:, None] * 1e-5
    hiss = noise * np.random.default_rng(7).normal(size=(len(angle), 1))
    motion = motion_of(
        counts, rate_hz=LOG_HZ, cutoff_hz=cutoff_hz, tau=log.torque[:, None] + hiss
    )
    settled = motion.usable.copy()
    settled[:500] = False
    motion = decimated(replace(motion, usable=settled), 24)

    chain = chain_from_dh([(0.0, 0.0, 0.0, 0.0)])
    robot = robot_from_chain(chain, gravity=np.array([0.0, -9.81, 0.0]))
    joint = replace(
        robot.joints[0], rotor_inertia=MOTOR, gear_ratio=1.0, encoder_side=side
    )
    robot = replace(robot, joints=(joint,))
    phi = np.zeros((1, 10))
    phi[0, 2] = -WEIGHT / 9.81
    phi[0, 9] = LINK
    surface = friction_surface(COULOMB, VISCOUS, top=20.0)
    model = TorqueModel(
        robot=robot,
        surfaces=[surface],
        phi=phi,
        rotor=np.array([MOTOR]),
        coupling="diagonal",
    )
    return Scene(
        robot=robot, motion=motion, model=model, sign_width=np.array([SIGN_WIDTH])
    )
