"""Causes of a misfit between log and robot, each as the change to log or robot that undoes it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample
from seqid_cli.inspect.material import LogData
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.types import Array


@dataclass(frozen=True)
class Cause:
    """A change that mends the fit: of which kind, of which joints.

    The two `joints` exchange their motion, their torque or both; then motion and torque are
    multiplied, and zeros shifted, all (n,).
    """

    code: str
    joints: tuple[int, ...]
    text: str
    channel: str = "position"
    exchanged: tuple[bool, bool] = (False, False)  # motion, torque
    motion: Array | float = 1.0
    torque: Array | float = 1.0
    shift: Array | float = 0.0
    gravity: Array | None = None  # (3,) m/s^2, that acts instead
    weighed: bool = False  # gravity as the URDF's inertials give it is added to the torque

    def on(self, sample: Sample) -> Sample:
        """Return the sample as it would be."""
        if self.gravity is not None:
            robot = replace(sample.robot, gravity=self.gravity)
            return replace(sample, robot=robot, basis=base_parameters(robot, rotor=()))
        order = np.arange(sample.robot.n)
        order[list(self.joints)] = self.joints[::-1]
        tau = sample.tau[:, order] if self.exchanged[1] else sample.tau
        if self.exchanged[0]:
            moving = tuple(sorted(order[list(sample.moving)].tolist()))
            sample = replace(sample.mapped(lambda x: x[:, order]), moving=moving)
        return replace(
            sample,
            q=sample.q * self.motion + self.shift,
            dq=sample.dq * self.motion,
            ddq=sample.ddq * self.motion,
            tau=(tau + sample.nominal()[0] if self.weighed else tau) * self.torque,
            direction=sample.direction * np.sign(self.motion),
        )


def causes_of(data: LogData, sample: Sample, *, units: bool = False) -> Iterator[Cause]:
    """Yield common faults of axes, zeros, signs, angles, order; of `units` of effort as well."""
    joints, every = sample.robot.joints, np.arange(sample.robot.n)

    def at(own: Sequence[int], value: float, usual: float = 1.0) -> Array:
        return np.where(np.isin(every, own), value, usual)

    far = np.abs(sample.q).max(axis=0) > 2.0 * np.pi  # less in degrees is no motion to speak of
    turning = tuple(j for j, joint in enumerate(joints) if not joint.prismatic)
    degrees = [(j,) for j in turning] + ([turning] if len(turning) > 1 else [])
    for group in (group for group in degrees if far[list(group)].any()):
        small = at(group, np.pi / 180.0)
        yield Cause("position_in_degrees", group, "is in degrees", motion=small)
    for j in every.tolist():
        back, own = at([j], -1.0), (j,)
        yield Cause("axis_flipped", own, "turns the other way round", motion=back, torque=back)
        yield Cause("sign_mismatch", own, "its torque is reversed", torque=back)
        yield Cause("sign_mismatch", own, "its position is reversed", motion=back)
        if j in turning:
            for turns, angle in (("a quarter", 0.5), ("minus a quarter", -0.5), ("half a", 1.0)):
                text = f"its zero is {turns} turn off"
                yield Cause("position_zero", own, text, shift=at([j], angle * np.pi, 0.0))
    # Exchanging a joint that stands with one that moves changes what is compared.
    for pair in combinations(sample.moving, 2):
        for text, exchanged in (
            ("are exchanged", (True, True)),
            ("have exchanged positions", (True, False)),
            ("have exchanged torques", (False, True)),
        ):
            if joints[pair[0]].prismatic == joints[pair[1]].prismatic:
                yield Cause("joints_swapped", pair, text, exchanged=exchanged)
    yield from _of_efforts(data, units=units)


def _of_efforts(data: LogData, *, units: bool) -> Iterator[Cause]:
    """Yield that the effort is the other quantity, or lacks gravity."""
    quantity, _ = data.effort() or ("torque", None)
    robot, every_joint = data.robot, tuple(range(data.robot.n))
    factor = np.array([abs(joint.torque_per_ampere or 0.0) for joint in robot.joints])
    if units and factor.all():
        other, scale = ("torque", 1.0 / factor) if quantity == "current" else ("current", factor)
        text = f"carry {other}, not {quantity}"
        yield Cause(f"effort_is_{other}", every_joint, text, quantity, torque=scale)
    told = robot.channels.effort == "gravity_compensated" or robot.nominal is None
    if quantity == "torque" and not told and robot.gravity.any():  # a driver subtracts it
        text = "gravity is not in it"
        yield Cause("effort_without_gravity", every_joint, text, "torque", weighed=True)


def mounted(gravity: Array) -> Cause:
    """Gravity (3,) m/s^2 that acts in another direction."""
    text = str([float(f"{x:.3g}") + 0.0 for x in gravity])
    return Cause("gravity_direction", (), text, gravity=gravity)
