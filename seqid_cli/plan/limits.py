"""How far, how fast and how hard each joint may move in a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.plan.options import PlanOptions
from seqid_cli.robot.types import Array, Joint, Robot
from seqid_cli.robot.urdf.joints import UrdfJoint


@dataclass(frozen=True)
class Limits:
    """Limits of all joints (n,) as the plan uses them; rad, rad/s, rad/s^2, N m (prismatic: m, N).

    `torque` is infinite where it is not given. `moves` is False for joints that are kept still.
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    torque: Array
    moves: NDArray[np.bool_]

    @property
    def range(self) -> Array:
        """Widths (n,) of the position ranges."""
        return self.upper - self.lower

    @property
    def moving(self) -> list[int]:
        """Numbers of the joints that move."""
        return [int(j) for j in np.flatnonzero(self.moves)]


def limits_of(
    robot: Robot, *, ramp_s: float, share: float = PlanOptions.share, locked: Sequence[str] = ()
) -> Limits:
    """Take the tighter of the robot file's limits and the URDF's, and `share` of that.

    Parameters
    ----------
    robot : Robot
    ramp_s : float
        Time [s] in which a joint may reach its largest speed: the only limit of acceleration.
    share : float
        Of every range that is used, about its middle.
    locked : sequence of str
        Joints that do not move.

    Raises
    ------
    ConfigError
        A joint that moves has no limits, or such that nothing fits within them.
    UsageError
        `locked` names no joint, or every joint.
    """
    moves = _moves(robot, locked)
    found = [_Found.of(robot, j, needed=moves[j]) for j in range(robot.n)]
    lower, upper = (np.array([getattr(f, side) for f in found]) for side in ("lower", "upper"))
    middle, half = (lower + upper) / 2, share * (upper - lower) / 2
    speed = share * np.array([f.speed for f in found])
    torque = share * np.array([f.torque for f in found])
    return Limits(middle - half, middle + half, speed, speed / ramp_s, torque, moves)


def _moves(robot: Robot, locked: Sequence[str]) -> NDArray[np.bool_]:
    for name in locked:
        if name not in robot.joint_names:
            hint = f"The robot's joints: {', '.join(robot.joint_names)}."
            raise UsageError(f"--lock names no joint: {name!r}", hint=hint)
    moves = np.array([name not in locked for name in robot.joint_names])
    if not moves.any():
        raise UsageError("every joint is locked: there is nothing to plan", hint="Leave one free.")
    return moves


@dataclass(frozen=True)
class _Found:
    """Limits of one joint as they were found."""

    lower: float
    upper: float
    speed: float
    torque: float

    @classmethod
    def of(cls, robot: Robot, j: int, *, needed: bool, slowest_s: float = 600.0) -> _Found:
        """Join both sources; a joint that need not move may lack its limits.

        `slowest_s`: time for the whole range at the speed limit: plans of slower joints would take
        days, and gigabytes.
        """
        joint = robot.joints[j]
        urdf = joint.urdf
        ranges = [joint.position_limits, _range_of(urdf)]
        given = [limits for limits in ranges if limits is not None]
        speed = _least(joint.velocity_limit, urdf.velocity if urdf else None)
        torque = _least(urdf.effort if urdf else None)
        if needed and (not given or math.isinf(speed)):
            raise _lacking(robot, joint, positions=bool(given))
        lower = max((low for low, _ in given), default=0.0)
        upper = min((high for _, high in given), default=0.0)
        if needed and lower >= upper:
            message = (
                f"joint {joint.name!r}: position limits {ranges[0]} and the URDF's {ranges[1]}"
            )
            hint = "Correct position_limits in the robot file."
            raise ConfigError(f"{message} exclude each other", where=str(robot.source), hint=hint)
        if needed and upper - lower > slowest_s * speed:
            unit = "m/s" if joint.prismatic else "rad/s"
            message = f"joint {joint.name!r} crosses its range in {(upper - lower) / speed:.3g} s"
            hint = f"Correct its limit of {speed:g} {unit}; up to {slowest_s:g} s are planned."
            raise ConfigError(message, where=str(robot.source), hint=hint)
        if not needed and lower > upper:
            lower = upper = 0.0
        return cls(lower, upper, 0.0 if math.isinf(speed) else speed, torque)


def _range_of(urdf: UrdfJoint | None) -> tuple[float, float] | None:
    """Range of a joint of a URDF; one turn where it turns without end."""
    if urdf is None:
        return None
    if urdf.kind == "continuous":
        return -math.pi, math.pi
    if urdf.lower is None or urdf.upper is None:
        return None
    return urdf.lower, urdf.upper


def _least(*values: float | None) -> float:
    return min((value for value in values if value is not None), default=math.inf)


def _lacking(robot: Robot, joint: Joint, *, positions: bool) -> ConfigError:
    what = "velocity_limit" if positions else "position_limits"
    units = ("m", "m/s") if joint.prismatic else ("rad", "rad/s")
    message = f"joint {joint.name!r} has no {what}, neither here nor in a URDF"
    hint = f"Add {what} ({units[positions]}) to this joint, or keep it still: --lock {joint.name}."
    return ConfigError(message, where=str(robot.source), hint=hint)
