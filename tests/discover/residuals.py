"""Systems whose residual is known: a two-joint arm whose joints move alike, coloured noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.system import Block, System
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from tests.model.effects.scenes import scene_of, torque_model, two_joint_robot, wander

Array = NDArray[np.float64]
Torque = Callable[[Scene], Array]  # (N,) N m at the joint under test

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


def measured(scenes: Sequence[Scene], seed: int, joint: int, extra: Torque | None) -> list[Array]:
    """Return torque (N, n) of each scene: the model's, noise, and a torque at one joint."""
    rng = np.random.default_rng(seed)
    result = []
    for scene in scenes:
        assert scene.motion.tau is not None
        tau = scene.motion.tau + coloured(scene, rng)
        if extra is not None:
            tau[:, joint] += scene.motion.filtered(extra(scene), times=2)
        result.append(tau)
    return result


def system_of(rows: Rows, tau: Sequence[Array]) -> System:
    """Return the system of rigid body, simple friction and timing."""
    base = base_of(rows, Stages())
    left = [x - scene.modelled_filtered for x, scene in zip(tau, rows.scenes, strict=True)]
    y = [rows.torque(j, left)[:, j] for j in range(rows.n)]
    blocks = [Block(dict(enumerate(base.rigid)), base.prior_rigid)]
    for j in range(rows.n):
        columns = np.column_stack([base.friction[j], base.timing[j]])
        blocks.append(Block({j: columns}, np.zeros((0, columns.shape[1]))))
    noise = [np.full(len(own), size) for own, size in zip(y, NOISE, strict=True)]
    return System(rows, y, noise, blocks)


def residual_system(seed: int, joint: int, extra: Torque | None, logs: int = 4) -> System:
    """Return the system of related logs with a torque at one joint."""
    scenes = related_scenes(seed, logs)
    rows = rows_of(scenes)
    return system_of(rows, measured(scenes, seed, joint, extra))
