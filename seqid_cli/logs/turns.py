"""Whole turns put back that encoders of one turn lose.

Such an encoder jumps from one end of its turn to the other while the joint goes on. The
position is made to run on, and moved by a turn where only that brings it within the
limits of the joint.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.logs.raw import Array, Stream
from seqid_cli.robot.types import Robot

TURN = 2.0 * np.pi


def in_turns(
    stream: Stream, robot: Robot, *, slack: float = 0.05
) -> tuple[Stream, dict[str, int]]:
    """Let revolute joints run on where they wrap, and move them within their limits.

    Parameters
    ----------
    stream : Stream
        Joint samples with `position` (M, n) [rad].
    robot : Robot
        Its joints have the limits; half a turn to either side where they have none.
    slack : float
        Share of a turn by which a step may differ from a whole one.

    Returns
    -------
    Stream
        The stream with positions that run on; the same object where nothing wraps.
    dict of str to int
        How often each joint wraps, for joints that do.
    """
    position = stream.channels["position"]
    unwrapped = position.copy()
    wraps_by_joint: dict[str, int] = {}
    for j, joint in enumerate(robot.joints):
        if joint.prismatic:
            continue
        q, n_wraps = _unwrapped(position[:, j], slack)
        if n_wraps:
            wraps_by_joint[joint.name] = n_wraps

        lower, upper = joint.position_limits or (-np.pi, np.pi)
        unwrapped[:, j] = q + TURN * _turns_to_limits(q, lower, upper)

    turned = stream
    if not np.array_equal(unwrapped, position, equal_nan=True):
        turned = replace(stream, channels={**stream.channels, "position": unwrapped})
    return commands_in_turns(turned, turned, robot, slack=slack), wraps_by_joint


def commands_in_turns(
    commands: Stream, joints: Stream, robot: Robot, *, slack: float = 0.05
) -> Stream:
    """Let commanded positions run on, and lie in the same turn as the positions.

    Parameters
    ----------
    commands : Stream
        Samples that may have `command` (M, n) [rad].
    joints : Stream
        Joint samples in the order of time, whose positions run on.
    slack : float
        As of `in_turns`.

    Returns
    -------
    Stream
        The same object where nothing has to be moved.
    """
    command = commands.channels.get("command")
    if command is None or not len(joints):
        return commands
    rows = np.arange(len(joints))
    if commands is not joints:
        rows = np.searchsorted(joints.stamp_ns, commands.stamp_ns)
        rows = np.minimum(rows, len(joints) - 1)

    moved = command.copy()
    for j, joint in enumerate(robot.joints):
        if joint.prismatic or not np.isfinite(command[:, j]).any():
            continue
        run_on, _ = _unwrapped(command[:, j], slack)
        difference = joints.channels["position"][rows, j] - run_on
        if np.isfinite(difference).any():
            moved[:, j] = run_on + TURN * np.rint(np.nanmedian(difference) / TURN)
    if np.array_equal(moved, command, equal_nan=True):
        return commands
    return replace(commands, channels={**commands.channels, "command": moved})


def _turns_to_limits(q: Array, lower: float, upper: float) -> int:
    """Return the turns, 0, -1 or 1, that bring q (M,) within limits; else 0."""
    least = np.nanmin(q, initial=np.inf)
    largest = np.nanmax(q, initial=-np.inf)
    for turns in (0, -1, 1):
        if lower <= least + TURN * turns and largest + TURN * turns <= upper:
            return turns
    return 0


def _unwrapped(q: Array, slack: float) -> tuple[Array, int]:
    """Return positions (M,) that run on, and how often they wrap.

    Nothing wraps where large steps are mostly no turns: then they are noise or faults.
    """
    present = np.flatnonzero(np.isfinite(q))
    steps = np.diff(q[present]) / TURN
    is_turn = np.abs(np.abs(steps) - 1.0) < slack
    turns = np.where(is_turn, np.sign(steps), 0.0)

    n_wraps = int(np.count_nonzero(turns))
    n_large_steps = np.count_nonzero(np.abs(steps) > slack)
    if 2 * n_wraps <= n_large_steps:
        return q, 0

    unwrapped = q.copy()
    unwrapped[present[1:]] -= TURN * np.cumsum(turns)
    return unwrapped, n_wraps
