"""Causes of a misfit between log and robot, each as the change to log or robot that undoes it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample
from seqid_cli.inspect.material import LogData
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot

Change = Callable[[Robot, Sample], tuple[Robot, Sample]]


@dataclass(frozen=True)
class Cause:
    """A change that mends the fit: of which kind, of which joints."""

    code: str
    joints: tuple[int, ...]
    text: str
    change: Change
    channel: str = "position"


def causes_of(robot: Robot, sample: Sample) -> Iterator[Cause]:
    """Yield the common faults of axes, zeros, signs, units and the order of joints."""
    far = np.abs(sample.q).max(axis=0) > 2.0 * np.pi  # less in degrees is no motion to speak of
    turning = tuple(j for j in range(robot.n) if not robot.joints[j].prismatic)
    degrees = [(j,) for j in turning] + ([turning] if len(turning) > 1 else [])
    for joints in (group for group in degrees if far[list(group)].any()):
        yield Cause("position_in_degrees", joints, "is in degrees", _scaled(joints, np.pi / 180.0))
    for j in range(robot.n):
        yield Cause("axis_flipped", (j,), "turns the other way round", _scaled((j,), -1.0, -1.0))
        yield Cause("sign_mismatch", (j,), "its torque is reversed", _scaled((j,), 1.0, -1.0))
        yield Cause("sign_mismatch", (j,), "its position is reversed", _scaled((j,), -1.0))
        if not robot.joints[j].prismatic:
            for turns, angle in (("a quarter", 0.5), ("minus a quarter", -0.5), ("half a", 1.0)):
                text = f"its zero is {turns} turn off"
                yield Cause("position_zero", (j,), text, _scaled((j,), 1.0, shift=angle * np.pi))
    # Exchanging a joint that stands with one that moves changes what is compared.
    for a, b in combinations(sample.moving, 2):
        for text, motion, torque in (
            ("are exchanged", True, True),
            ("have exchanged positions", True, False),
            ("have exchanged torques", False, True),
        ):
            if robot.joints[a].prismatic == robot.joints[b].prismatic:
                change = _swapped(a, b, motion=motion, torque=torque)
                yield Cause("joints_swapped", (a, b), text, change)


def units_of(data: LogData) -> Iterator[Cause]:
    """Yield efforts that are the other quantity, where the robot file gives the drives' data."""
    effort, joints = data.effort(), data.robot.joints
    factor = np.array([abs(joint.torque_per_ampere or 0.0) for joint in joints])
    if effort is None or not factor.all():
        return
    every, logged = tuple(range(len(joints))), effort[0]
    other, scale = ("torque", 1.0 / factor) if logged == "current" else ("current", factor)

    def change(robot: Robot, sample: Sample) -> tuple[Robot, Sample]:
        return robot, replace(sample, tau=sample.tau * scale)

    yield Cause(f"effort_is_{other}", every, f"carry {other}, not {logged}", change, logged)


def compensated(data: LogData) -> Iterator[Cause]:
    """Yield torques that lack gravity as the URDF's inertials give it: a driver subtracts it."""
    effort, robot = data.effort(), data.robot
    told = robot.channels.effort == "gravity_compensated" or robot.nominal is None
    if effort is None or effort[0] != "torque" or told or not robot.gravity.any():
        return

    def change(robot: Robot, sample: Sample) -> tuple[Robot, Sample]:
        assert robot.nominal is not None
        still = np.zeros_like(sample.q)
        weight = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, sample.q, still, still)
        return robot, replace(sample, tau=sample.tau + weight)

    every = tuple(range(robot.n))
    yield Cause("effort_without_gravity", every, "gravity is not in it", change, "torque")


def mounted(gravity: Array) -> Cause:
    """Gravity (3,) m/s^2 that acts in another direction."""

    def change(robot: Robot, sample: Sample) -> tuple[Robot, Sample]:
        turned = replace(robot, gravity=gravity)
        return turned, replace(sample, basis=base_parameters(turned, rotor=[]))

    return Cause("gravity_direction", (), str([float(f"{x:.3g}") + 0.0 for x in gravity]), change)


def _scaled(
    joints: Sequence[int], motion: float, torque: float = 1.0, shift: float = 0.0
) -> Change:
    """Some joints' motion and torque times factors, and their zeros shifted."""

    def change(robot: Robot, sample: Sample) -> tuple[Robot, Sample]:
        own = np.isin(np.arange(sample.q.shape[1]), joints)
        moved = np.where(own, motion, 1.0)
        return robot, replace(
            sample,
            q=sample.q * moved + np.where(own, shift, 0.0),
            dq=sample.dq * moved,
            ddq=sample.ddq * moved,
            tau=sample.tau * np.where(own, torque, 1.0),
            direction=sample.direction * np.sign(moved),
        )

    return change


def _swapped(a: int, b: int, *, motion: bool, torque: bool) -> Change:
    def change(robot: Robot, sample: Sample) -> tuple[Robot, Sample]:
        order = list(range(sample.q.shape[1]))
        order[a], order[b] = b, a
        if not motion:
            return robot, replace(sample, tau=sample.tau[:, order])
        moving = tuple(sorted({a: b, b: a}.get(j, j) for j in sample.moving))
        swapped = sample.mapped(lambda x: x[:, order], torque=torque)
        return robot, replace(swapped, moving=moving)

    return change
