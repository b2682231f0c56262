"""Logs of a two-joint arm whose joints move alike, and coloured noise."""

from __future__ import annotations

import numpy as np

from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.plants.robots.two_joint import torque_model, two_joint_robot
from tests.unit.model.effects.scenes import scene_of, wander

NOISE = (0.3, 0.1)  # N m RMS per joint, after the low-pass
ALIKE = 0.6  # share of the first joint's motion in the second's


def related_scenes(seed: int, logs: int = 4, seconds: float = 20.0) -> list[Scene]:
    """Return logs in which the second joint moves partly like the first."""
    robot = two_joint_robot()
    model = torque_model(robot)
    scenes = []
    for log in range(logs):
        q = wander(seconds, seed=100 * seed + log, top_hz=0.6, rests=())
        q[:, 1] = ALIKE * q[:, 0] + np.sqrt(1 - ALIKE**2) * q[:, 1]
        scenes.append(scene_of(q, robot=robot, model=model, log=log))
    return scenes


def coloured(scene: Scene, rng: np.random.Generator) -> Array:
    """Return noise (N, n) N m as the twice low-passed torque has it."""
    white = scene.motion.filtered(rng.normal(size=scene.motion.q.shape), times=2)
    noise: Array = white / np.std(white, axis=0) * np.array(NOISE)
    return noise
