"""What the logs make a joint do: whether it moves, how fast, how far, for how long."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seqid_cli.model.effects.scene import Scene


def moves(scenes: Sequence[Scene], joint: int) -> bool:
    """Return whether the joint moves in any log."""
    return any(bool(scene.motion.moving[:, joint].any()) for scene in scenes)


def top_speed(scenes: Sequence[Scene], joint: int) -> float:
    """Return the joint's highest speed [rad/s; m/s where prismatic] where the filter has settled.

    At least 1e-6, so that a joint that never moves has a scale as well.
    """
    speeds = [np.abs(scene.motion.dq[scene.motion.usable, joint]) for scene in scenes]
    return max(float(np.max(np.concatenate(speeds), initial=0.0)), 1e-6)


def travel(scenes: Sequence[Scene], joint: int) -> float:
    """Return the range of the joint's positions [rad; m where prismatic], at least 1e-6."""
    positions = np.concatenate([s.motion.q[s.motion.usable, joint] for s in scenes])
    return max(float(np.ptp(positions)) if len(positions) else 0.0, 1e-6)


def has_rigid_body(scenes: Sequence[Scene]) -> bool:
    """Return whether the model knows the load of the gears: it has a rigid-body stage."""
    return all(scene.model.phi is not None for scene in scenes)


def session(scenes: Sequence[Scene]) -> float:
    """Return the time [s] on the clock at which the last log ends."""
    return max(float(scene.time[-1]) for scene in scenes)
