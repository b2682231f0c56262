"""Ripple by angle: which order, which law, how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.torque_ripple import LAWS, TorqueRipple, highest_order
from tests.plants.robots.two_joint import GEAR, two_joint_robot
from tests.unit.model.effects.fitting import Array
from tests.unit.model.effects.scenes import scene_of, wander

SIN, COS = 0.6, 0.8


def rippling(order: float, law: int, *, seed: int, gear: float = GEAR[1]) -> tuple[Scene, Array]:
    """Return a scene and its unfiltered residual: ripple, noise and a bump of position."""
    robot = two_joint_robot()
    joints = (robot.joints[0], replace(robot.joints[1], gear_ratio=None if gear == 1.0 else gear))
    scene = scene_of(wander(30.0, seed=seed, amplitude=1.5), robot=replace(robot, joints=joints))
    q, rng = scene.motion.q[:, 1], np.random.default_rng(seed)
    every = (1.0, scene.modelled[:, 1], np.sign(scene.motion.dq[:, 1]), scene.load[:, 1])
    size = (1.0, 0.05, 1.0, 0.05)[law] * every[law]
    p = order * gear * q
    torque = size * (SIN * np.sin(p) + COS * np.cos(p))
    other = 0.5 * np.exp(-((q - 0.4) ** 2)) + rng.normal(size=len(q))
    residual = np.stack([rng.normal(size=len(q)), torque + other], axis=1)
    residual[~scene.motion.usable] = 0.0
    return scene, residual


@pytest.mark.parametrize("law", range(len(LAWS)), ids=LAWS)
@pytest.mark.parametrize(("order", "gear"), [(2.0, GEAR[1]), (6.0, GEAR[1]), (13.7, 1.0)])
def test_order_law_and_size_come_back(order: float, gear: float, law: int) -> None:
    """A whole number of cycles per motor turn is named as such."""
    effect = TorqueRipple()
    scenes, residual = zip(*(rippling(order, law, seed=k, gear=gear) for k in (0, 1)), strict=True)
    y = np.concatenate([r[:, 1] for r in residual])
    tried = []
    for settings in effect.grid(scenes, 1, residual):
        X = np.concatenate([effect.columns(scene, 1, settings)[1] for scene in scenes])
        c = np.linalg.lstsq(X[y != 0.0], y[y != 0.0])[0]
        tried.append((float(np.sum((y - X @ c)[y != 0.0] ** 2)), settings, c))
    _, best, c = min(tried, key=lambda item: item[0])
    assert best["law"] == law
    assert best["order"] == pytest.approx(order, abs=0.0 if gear != 1.0 else 0.02)
    scaled = LAWS[law] in ("torque", "load")
    scale = 0.05 if scaled else 1.0
    values = effect.values(scenes[0].robot, 1, best, c, 1e-6 * np.eye(2))
    assert values[0].value == pytest.approx(scale, rel=0.1)
    assert values[0].unit == ("1" if scaled else "N m")
    assert values[1].value == pytest.approx(np.arctan2(COS, SIN), abs=0.15)
    assert len(tried) <= 20


def test_a_ripple_that_comes_late_is_found_both_ways() -> None:
    """At some 20 Hz no sine of the angle itself holds for both directions."""
    lag, order = 0.015, 2.0
    scene, _ = rippling(order, 0, seed=3)
    motion, rng = scene.motion, np.random.default_rng(3)
    p = order * GEAR[1] * (motion.q[:, 1] - lag * motion.dq[:, 1])
    residual = rng.normal(size=motion.q.shape)
    residual[:, 1] += SIN * np.sin(p) + COS * np.cos(p)
    residual[~motion.usable] = 0.0
    y = residual[:, 1]
    gains = {}
    for settings in TorqueRipple().grid([scene], 1, [residual]):
        X = TorqueRipple().columns(scene, 1, settings)[1]
        c = np.linalg.lstsq(X[y != 0.0], y[y != 0.0])[0]
        gains[settings["order"], settings["law"], settings["lag"]] = float(
            np.sum(y**2) - np.sum((y - X @ c)[y != 0.0] ** 2)
        )
    assert max(gains, key=lambda key: gains[key]) == (order, 0.0, lag)
    assert all(law == 0.0 for _, law, late in gains if late > 0.0)


def test_usual_orders_are_tried_where_logs_are_too_fast_for_their_spectrum() -> None:
    """Two waves per turn of a large gear are above what most samples of a fast log resolve."""
    effect, gear = TorqueRipple(), 400.0
    scene, residual = rippling(2.0, 0, seed=5, gear=gear)
    assert highest_order([scene], 1) < 2.0 * gear
    found = [s["order"] for s in effect.grid([scene], 1, [residual]) if s["law"] == 0.0]
    assert {1.0, 2.0} <= set(found)
    coarse, residual = rippling(2.0, 0, seed=5, gear=4.0)
    orders = [s["order"] for s in effect.grid([coarse], 1, [residual])]
    assert 1.0 not in orders  # four waves per turn are a smooth function of position
