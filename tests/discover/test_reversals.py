"""Columns for what reversals leave of friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from seqid_cli.discover.reversals import reversal_columns
from seqid_cli.model.effects.scene import Scene
from tests.discover.arms import arm_scenes

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return arm_scenes(logs=1)[0]


def fitted(columns: Array, torque: Array, joint: int) -> tuple[Array, float]:
    """Coefficients at a joint, and what is left over what there was."""
    X, y = columns[100:-100, joint], torque[100:-100, joint]
    c = np.linalg.lstsq(X, y, rcond=None)[0]
    return c, float(np.std(y - X @ c) / np.std(y))


@pytest.mark.parametrize("joint", [0, 1])
def test_steps_that_are_ramps(scene: Scene, joint: int) -> None:
    """A joint that sticks for T when it reverses has T^2 / 24 of the first column."""
    samples = 9
    stuck = samples / scene.motion.rate_hz
    ramps = uniform_filter1d(scene.friction, samples, axis=0)
    torque = scene.motion.filtered(ramps - scene.friction, times=2)
    c, left = fitted(reversal_columns(scene), torque, joint)
    assert c[0] == pytest.approx(stuck**2 / 24, rel=0.1)
    assert left < 0.1


@pytest.mark.parametrize("joint", [0, 1])
def test_crossings_that_come_late(scene: Scene, joint: int) -> None:
    """A low-passed velocity is off by its curvature, and so is the time of its crossing."""
    moment = 4e-5  # s^2
    motion = scene.motion
    jerk = np.gradient(motion.ddq, 1.0 / motion.rate_hz, axis=0)
    true = replace(scene, motion=replace(motion, dq=motion.dq + moment * jerk))
    torque = motion.filtered(true.friction - scene.friction, times=2)
    c, left = fitted(reversal_columns(scene), torque, joint)
    assert c[1] == pytest.approx(moment, rel=0.15)
    assert left < 0.3


def test_without_friction_there_is_nothing(scene: Scene) -> None:
    bare = replace(scene, model=replace(scene.model, surfaces=(None, None)))
    assert not reversal_columns(bare).any()
