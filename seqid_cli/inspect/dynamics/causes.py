"""Common faults of logs and robot files, each as the change that undoes it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample
from seqid_cli.inspect.dynamics.structure import torque_sizes
from seqid_cli.inspect.material import LogData
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.types import Array, Robot


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A fault of some joints, and the change of a sample that undoes it.

    Attributes
    ----------
    code : str
        Code of the finding.
    joints : tuple of int
        Joints that it is about; none for the mounting.
    text : str
        What is wrong, in words.
    channel : str
        Channel that is wrong.
    exchanges_motion, exchanges_torque : bool
        Whether the two `joints` exchange their motion, or their torque.
    motion, torque : float or (n,) array
        Factors of motion and torque, after the exchange.
    shift : float or (n,) array
        Added to positions [rad].
    gravity : (3,) array, optional
        Gravity that acts instead, m/s^2 in the base frame.
    adds_gravity : bool
        Whether gravity by the URDF's inertials is added to the torque.
    """

    code: str
    joints: tuple[int, ...]
    text: str
    channel: str = "position"
    exchanges_motion: bool = False
    exchanges_torque: bool = False
    motion: Array | float = 1.0
    torque: Array | float = 1.0
    shift: Array | float = 0.0
    gravity: Array | None = None
    adds_gravity: bool = False

    def on(self, sample: Sample) -> Sample:
        """Return the sample as it would be without the fault."""
        if self.gravity is not None:
            robot = replace(sample.robot, gravity=self.gravity)
            basis = base_parameters(robot, rotor=())
            return replace(sample, robot=robot, basis=basis)

        order = np.arange(sample.robot.n)
        order[list(self.joints)] = self.joints[::-1]
        tau = sample.tau[:, order] if self.exchanges_torque else sample.tau
        if self.exchanges_motion:
            moving = tuple(sorted(order[list(sample.moving)].tolist()))
            sample = replace(sample.mapped(lambda x: x[:, order]), moving=moving)
        if self.adds_gravity:
            # Much gravity beside a small torque would make any error a small share.
            sample = replace(sample, sizes=torque_sizes(sample))
            tau = tau + sample.nominal()[0]
        return replace(
            sample,
            q=sample.q * self.motion + self.shift,
            dq=sample.dq * self.motion,
            ddq=sample.ddq * self.motion,
            tau=tau * self.torque,
            direction=sample.direction * np.sign(self.motion),
        )


def mounted(gravity: Array) -> Cause:
    """Return that gravity (3,) m/s^2 acts in another direction."""
    # Adding zero turns -0.0 into 0.0.
    text = str([float(f"{x:.3g}") + 0.0 for x in gravity])
    return Cause(code="gravity_direction", joints=(), text=text, gravity=gravity)


def zero_off(robot: Robot, j: int, angle: float) -> Cause:
    """Return that positions of a revolute joint lack an angle [rad]."""
    shift = np.where(np.arange(robot.n) == j, angle, 0.0)
    text = f"its zero is {-angle:.3g} rad off"
    return Cause(code="position_zero", joints=(j,), text=text, shift=shift)


def causes_of(data: LogData, sample: Sample, *, units: bool = False) -> Iterator[Cause]:
    """Yield common faults of axes, zeros, signs, angles and order of joints.

    Parameters
    ----------
    data : LogData
        The log.
    sample : Sample
        Its filtered motion and torque.
    units : bool
        Whether current may have been logged for torque, or torque for current.
    """
    yield from _degrees(sample)
    for j in range(sample.robot.n):
        yield from _of_joint(sample.robot, j)
    yield from _exchanges(sample)
    yield from _of_efforts(data, units=units)


def _at(robot: Robot, joints: Sequence[int], value: float, usual: float = 1.0) -> Array:
    """Return `value` at some joints and `usual` at the others, (n,)."""
    return np.where(np.isin(np.arange(robot.n), joints), value, usual)


def _degrees(sample: Sample) -> Iterator[Cause]:
    """Yield that positions of one revolute joint are in degrees.

    Another unit of all angles is told by `angles`.
    """
    robot = sample.robot
    # Less than a turn in degrees is no motion to speak of.
    is_far = np.abs(sample.q).max(axis=0) > 2.0 * np.pi
    for j, joint in enumerate(robot.joints):
        if is_far[j] and not joint.prismatic:
            yield Cause(
                code="position_in_degrees",
                joints=(j,),
                text="is in degrees",
                motion=_at(robot, [j], np.pi / 180.0),
            )


def _of_joint(robot: Robot, j: int) -> Iterator[Cause]:
    """Yield faults of the axis, the signs and the zero of one joint."""
    reversal = _at(robot, [j], -1.0)
    yield Cause(
        code="axis_flipped",
        joints=(j,),
        text="turns the other way round",
        motion=reversal,
        torque=reversal,
    )
    yield Cause(
        code="sign_mismatch",
        joints=(j,),
        text="its torque is reversed",
        torque=reversal,
    )
    yield Cause(
        code="sign_mismatch",
        joints=(j,),
        text="its position is reversed",
        motion=reversal,
    )
    if robot.joints[j].prismatic:
        return

    # A joint that is mounted or declared another way is off by quarters of a turn.
    turns = (("a quarter", 0.5), ("minus a quarter", -0.5), ("half a", 1.0))
    for words, half_turns in turns:
        yield Cause(
            code="position_zero",
            joints=(j,),
            text=f"its zero is {words} turn off",
            shift=_at(robot, [j], half_turns * np.pi, 0.0),
        )


def _exchanges(sample: Sample) -> Iterator[Cause]:
    """Yield that two joints are exchanged, in both or in one of motion and torque."""
    joints = sample.robot.joints
    # Exchanging a joint that stands with one that moves changes what is compared.
    for pair in combinations(sample.moving, 2):
        if joints[pair[0]].prismatic != joints[pair[1]].prismatic:
            continue
        for text, motion, torque in (
            ("are exchanged", True, True),
            ("have exchanged positions", True, False),
            ("have exchanged torques", False, True),
        ):
            yield Cause(
                code="joints_swapped",
                joints=pair,
                text=text,
                exchanges_motion=motion,
                exchanges_torque=torque,
            )


def _of_efforts(data: LogData, *, units: bool) -> Iterator[Cause]:
    """Yield that the effort is the other quantity, or lacks gravity."""
    robot = data.robot
    joints = tuple(range(robot.n))
    effort = data.effort()
    quantity = "torque" if effort is None else effort[0]

    torque_per_ampere = np.array(
        [abs(joint.torque_per_ampere or 0.0) for joint in robot.joints]
    )
    if units and torque_per_ampere.all():
        other_quantity = "torque" if quantity == "current" else "current"
        factor = torque_per_ampere
        if quantity == "current":
            factor = 1.0 / torque_per_ampere
        yield Cause(
            code=f"effort_is_{other_quantity}",
            joints=joints,
            text=f"carry {other_quantity}, not {quantity}",
            channel=quantity,
            torque=factor,
        )

    # Some drivers subtract gravity. Where the robot file says so, it is added already.
    is_known = robot.channels.effort == "gravity_compensated"
    if quantity != "torque" or is_known or robot.nominal is None:
        return
    if robot.gravity.any():
        yield Cause(
            code="effort_without_gravity",
            joints=joints,
            text="gravity is not in it",
            channel="torque",
            adds_gravity=True,
        )
