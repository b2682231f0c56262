"""A body put on the flange between two logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.payload import Payload
from seqid_cli.model.effects.scene import Scene
from tests.unit.model.effects.measured import best_fitted
from tests.unit.model.effects.scenes import scene_of, wander

MASS, AT = 2.5, np.array([0.05, -0.1, 0.15])  # kg, m


def point_mass() -> np.ndarray:
    """Inertial parameters of a small body, about the flange's origin."""
    I = MASS * (AT @ AT * np.eye(3) - np.outer(AT, AT))
    return np.array([MASS, *(MASS * AT), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])


def loaded(scene: Scene) -> Scene:
    """The same arm with the mass on its last link, by the recursive way."""
    phi = scene.model.phi
    assert phi is not None
    heavy = replace(scene.model, phi=phi + np.array([np.zeros(10), point_mass()]))
    motion = scene.motion
    extra = heavy.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    assert motion.tau is not None
    return replace(scene, motion=replace(motion, tau=motion.tau + motion.filtered(extra)))


def test_mass_moment_and_log_come_back() -> None:
    scenes = [scene_of(wander(15.0, seed=k), log=k) for k in range(3)]
    scenes[2] = loaded(scenes[2])
    settings, c, rms = best_fitted(Payload(), scenes, None)
    assert settings == {"from_log": 2.0}
    visible = Payload().columns(scenes[2], None, settings)
    rest = {j: X @ (c - point_mass()) for j, X in visible.items()}
    assert rms < 1e-6
    assert max(float(np.max(np.abs(r))) for r in rest.values()) < 1e-4
    assert c[1] == pytest.approx(MASS * AT[0], abs=1e-3)
    assert c[2] == pytest.approx(MASS * AT[1], abs=1e-3)
