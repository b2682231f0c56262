"""Whole turns that encoders of one turn lose, put back."""

from dataclasses import replace

import numpy as np

from seqid_cli.logs.raw import Array, Stream
from seqid_cli.robot.types import Joint, Robot

TURN = 2.0 * np.pi


def in_turns(stream: Stream, robot: Robot, *, slack: float = 0.05) -> tuple[Stream, dict[str, int]]:
    """Let revolute joints run on where they wrap, within their limits; tell how often each does.

    `slack`: share of a turn by which a step may differ from whole ones. A log that lies within the
    limits (half a turn, where there are none) only with a turn more or less is moved by it. The
    same stream is returned where nothing wraps.
    """
    position = stream.channels["position"]
    moved, found = position.copy(), dict[str, int]()
    for j, joint in enumerate(robot.joints):
        if not joint.prismatic:
            run, times = _unwrapped(position[:, j], slack)
            moved[:, j] = run + TURN * _turns_off(run, joint)
            found |= {joint.name: times} if times else {}
    if np.array_equal(moved, position, equal_nan=True):
        return stream, found
    return replace(stream, channels={**stream.channels, "position": moved}), found


def _unwrapped(q: Array, slack: float) -> tuple[Array, int]:
    """Positions (M,) that run on, and how often they wrap: steps of no turn are not more."""
    there = np.flatnonzero(np.isfinite(q))
    d = np.diff(q[there]) / TURN
    turns = np.where(np.abs(np.abs(d) - 1.0) < slack, np.sign(d), 0.0)
    count = int(np.count_nonzero(turns))
    if 2 * count <= np.count_nonzero(np.abs(d) > slack):
        return q, 0
    run = q.copy()
    run[there[1:]] -= TURN * np.cumsum(turns)
    return run, count


def _turns_off(q: Array, joint: Joint) -> int:
    """Turns (-1, 0 or 1) that bring all positions within the limits."""
    low, high = joint.position_limits or (-np.pi, np.pi)
    least, most = np.nanmin(q, initial=np.inf), np.nanmax(q, initial=-np.inf)
    if least > most or (low <= least and most <= high):
        return 0
    return next((k for k in (-1, 1) if low <= least + TURN * k and most + TURN * k <= high), 0)
