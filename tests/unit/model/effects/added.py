"""Scenes whose measured torque holds something that the model does not."""

from __future__ import annotations

from dataclasses import replace

from seqid_cli.model.effects.scene import Scene
from tests.unit.model.effects.fitting import Law, trial


def scenes_with(
    law: Law, *, logs: int = 2, noise: float = 0.05, top_hz: float = 0.8
) -> list[Scene]:
    """Return logs of the two-joint arm, a law's torque (t, q, dq) of the true motion added."""
    scenes = []
    for number in range(logs):
        each = trial(law, seed=number, noise=noise, top_hz=top_hz, log=number)
        scene, motion = each.scene, each.scene.motion
        known = motion.filtered(scene.rigid) + motion.filtered(scene.friction, times=2)
        scenes.append(replace(scene, motion=replace(motion, tau=known + each.torque)))
    return scenes
