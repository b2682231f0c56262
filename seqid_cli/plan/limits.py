"""How far, how fast and how hard each joint may move in a plan."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.plan.options import PlanOptions
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class Limits:
    """Limits of all joints (n,) as the plan uses them; rad, rad/s, rad/s^2, N m (prismatic: m, N).

    `torque` is infinite where it is not given. `moves` is False for joints that are
    kept still.
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


def limits_of(
    robot: Robot,
    *,
    ramp_s: float,
    share: float = PlanOptions.share,
    locked: Sequence[str] = (),
) -> Limits:
    """Take the tighter of the robot file's limits and the URDF's, and `share` of that.

    `ramp_s` is the time [s] in which a joint may reach its largest speed, the only
    limit of acceleration; `share` is of every range that is used, about its middle;
    `locked` joints stay.
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
    found = [_of_joint(robot, j, needed=bool(moves[j])) for j in range(robot.n)]
    lower, upper, speed, torque = np.array(found).T
    middle, half, speed = (
        (lower + upper) / 2,
        share * (upper - lower) / 2,
        share * speed,
    )
    return Limits(
        middle - half, middle + half, speed, speed / ramp_s, share * torque, moves
    )


def _of_joint(
    robot: Robot, j: int, *, needed: bool, slowest_s: float = 600.0
) -> tuple[float, float, float, float]:
    """Ends of the range, speed and torque by both sources; a joint that stays may lack some."""
    joint, where = robot.joints[j], str(robot.source)
    urdf, of_urdf = joint.urdf, None
    if urdf is not None and urdf.kind == "continuous":  # one turn of many
        of_urdf = (-math.pi, math.pi)
    elif urdf is not None and urdf.lower is not None and urdf.upper is not None:
        of_urdf = (urdf.lower, urdf.upper)
    given = [
        limits for limits in (joint.position_limits, of_urdf) if limits is not None
    ]
    speeds = (joint.velocity_limit, urdf.velocity if urdf else None)
    speed = min((v for v in speeds if v is not None), default=math.inf)
    torque = math.inf if urdf is None or urdf.effort is None else urdf.effort
    if needed and (not given or math.isinf(speed)):
        what, unit = (
            ("velocity_limit", "rad/s") if given else ("position_limits", "rad")
        )
        message = f"joint {joint.name!r} has no {what}, neither here nor in a URDF"
        own = f"{what} ({joint.unit(unit)})"
        hint = f"Add {own} to this joint, or keep it still: --lock {joint.name}."
        raise ConfigError(message, where=where, hint=hint)
    lower = max((low for low, _ in given), default=0.0)
    upper = min((high for _, high in given), default=0.0)
    if needed and lower >= upper:
        both = f"{joint.position_limits} and the URDF's {of_urdf}"
        message = f"joint {joint.name!r}: position limits {both} exclude each other"
        raise ConfigError(
            message, where=where, hint="Correct position_limits in the robot file."
        )
    # its plan would take days, and gigabytes
    if needed and upper - lower > slowest_s * speed:
        message = (
            f"joint {joint.name!r} crosses its range in {(upper - lower) / speed:.3g} s"
        )
        limit = f"limit of {speed:g} {joint.unit('rad/s')}"
        hint = f"Correct its {limit}; up to {slowest_s:g} s are planned."
        raise ConfigError(message, where=where, hint=hint)
    if lower > upper:
        lower = upper = 0.0
    return lower, upper, 0.0 if math.isinf(speed) else speed, torque
