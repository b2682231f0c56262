"""How far, how fast and how hard each joint may move in a plan."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.plan.options import PlanOptions
from seqid_cli.robot.types import Joint, Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of all n joints as the plan uses them.

    Parameters
    ----------
    lower, upper : (n,) float
        Ends of the position ranges [rad; m where prismatic].
    speed : (n,) float
        Largest speeds [rad/s; m/s where prismatic].
    acceleration : (n,) float
        Largest accelerations [rad/s^2; m/s^2 where prismatic].
    torque : (n,) float
        Largest torques [N m; N where prismatic]; infinite where the URDF has none.
    moves : (n,) bool
        Whether the joint moves; the others are kept still.
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    torque: Array
    moves: Mask

    @property
    def range(self) -> Array:
        """Widths (n,) of the position ranges."""
        return self.upper - self.lower

    @property
    def moving(self) -> list[int]:
        """Numbers of the joints that move."""
        return [int(j) for j in np.flatnonzero(self.moves)]


@dataclass(frozen=True)
class _JointLimits:
    """Limits of one joint before the share that a plan uses is taken of them."""

    lower: float
    upper: float
    speed: float
    torque: float


def limits_of(
    robot: Robot,
    *,
    ramp_s: float,
    share: float = PlanOptions.share,
    locked: Sequence[str] = (),
) -> Limits:
    """Take the tighter of the robot file's limits and the URDF's, and `share` of that.

    Parameters
    ----------
    robot : Robot
    ramp_s : float
        Time in which a joint may reach its largest speed [s]. It is the only limit of
        acceleration, as neither file has one.
    share : float
        Share of every limit that is used; a position range shrinks about its middle.
    locked : sequence of str
        Names of the joints that are kept still.

    Raises
    ------
    UsageError
        A locked joint is none of the robot's, or all are locked.
    ConfigError
        A joint that moves has no limits, or impossible ones.
    """
    for name in locked:
        if name not in robot.joint_names:
            hint = f"The robot's joints: {', '.join(robot.joint_names)}."
            raise UsageError(f"--lock names no joint: {name!r}", hint=hint)
    moves = np.array([name not in locked for name in robot.joint_names])
    if not moves.any():
        raise UsageError(
            "every joint is locked: there is nothing to plan", hint="Leave one free."
        )

    joints = [_limits_of_joint(robot, j, needed=bool(moves[j])) for j in range(robot.n)]
    lower = np.array([joint.lower for joint in joints])
    upper = np.array([joint.upper for joint in joints])
    speed = share * np.array([joint.speed for joint in joints])
    torque = share * np.array([joint.torque for joint in joints])

    middle = (lower + upper) / 2
    half_range = share * (upper - lower) / 2
    return Limits(
        lower=middle - half_range,
        upper=middle + half_range,
        speed=speed,
        acceleration=speed / ramp_s,
        torque=torque,
        moves=moves,
    )


def _limits_of_joint(robot: Robot, j: int, *, needed: bool) -> _JointLimits:
    """Return the limits of a joint by both sources.

    Limits of a joint that is kept still are not `needed`: it may lack some.
    """
    joint = robot.joints[j]
    urdf_range = _urdf_range(joint)
    ranges = [
        limits for limits in (joint.position_limits, urdf_range) if limits is not None
    ]
    lower = max((low for low, _ in ranges), default=0.0)
    upper = min((high for _, high in ranges), default=0.0)

    urdf_speed = joint.urdf.velocity if joint.urdf else None
    speeds = [v for v in (joint.velocity_limit, urdf_speed) if v is not None]
    speed = min(speeds, default=math.inf)
    torque = math.inf
    if joint.urdf is not None and joint.urdf.effort is not None:
        torque = joint.urdf.effort

    if needed:
        _check_given(robot, joint, has_range=bool(ranges), speed=speed)
        if lower >= upper:
            both_ranges = f"{joint.position_limits} and the URDF's {urdf_range}"
            message = (
                f"joint {joint.name!r}: position limits {both_ranges} exclude each"
                " other"
            )
            hint = "Correct position_limits in the robot file."
            raise ConfigError(message, where=str(robot.source), hint=hint)
        _check_crossing_time(robot, joint, upper - lower, speed)

    if lower > upper:
        lower = upper = 0.0
    if math.isinf(speed):
        speed = 0.0
    return _JointLimits(lower=lower, upper=upper, speed=speed, torque=torque)


def _urdf_range(joint: Joint) -> tuple[float, float] | None:
    """Return the position range of a joint in the URDF [rad; m where prismatic]."""
    urdf = joint.urdf
    if urdf is None:
        return None
    # A continuous joint gets one turn of many: a plan needs ends.
    if urdf.kind == "continuous":
        return (-math.pi, math.pi)
    if urdf.lower is None or urdf.upper is None:
        return None
    return (urdf.lower, urdf.upper)


def _check_given(robot: Robot, joint: Joint, *, has_range: bool, speed: float) -> None:
    """Refuse a joint that moves and has no range or no speed limit."""
    if has_range and not math.isinf(speed):
        return
    key = "velocity_limit" if has_range else "position_limits"
    unit = joint.unit("rad/s" if has_range else "rad")
    message = f"joint {joint.name!r} has no {key}, neither here nor in a URDF"
    hint = f"Add {key} ({unit}) to this joint, or keep it still: --lock {joint.name}."
    raise ConfigError(message, where=str(robot.source), hint=hint)


def _check_crossing_time(
    robot: Robot, joint: Joint, width: float, speed: float, *, slowest_s: float = 600.0
) -> None:
    """Refuse a joint so slow that its plan would take days, and gigabytes."""
    if width <= slowest_s * speed:
        return
    message = f"joint {joint.name!r} crosses its range in {width / speed:.3g} s"
    limit = f"limit of {speed:g} {joint.unit('rad/s')}"
    hint = f"Correct its {limit}; up to {slowest_s:g} s are planned."
    raise ConfigError(message, where=str(robot.source), hint=hint)
