"""Where a push acted, from the torques that it leaves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.discover.contact import contact_point
from seqid_cli.discover.survey.events import Interval
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.kinematics import forward
from tests import ROOT, Array
from tests.unit.effects.scenes import wander

ROBOT = load_robot(ROOT / "sample_logs" / "six_joint" / "robot.toml")
SECONDS, RATE_HZ = 12.0, 50.0
NOISE = 0.05  # N m
PUSH = Interval(scene=0, start=4.0, end=9.0, joints=(0, 1, 2, 3), score=30.0)


def pushed(point: Array, force: Array, link: int) -> SimpleNamespace:
    """An investigation of a log in which a link is pushed at a point (m, its frame)."""
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    parts = [wander(SECONDS, seed=seed)[: 4 * len(t) : 4] for seed in range(3)]
    q = np.hstack(parts)[: len(t), : ROBOT.n]
    frames = forward(ROBOT.chain, q)
    at = frames.p[:, link] + frames.R[:, link] @ point
    turning = np.cross(frames.z, at[:, None] - frames.p)
    turning[:, link + 1 :] = 0.0
    since = (t - PUSH.start) / (PUSH.end - PUSH.start)
    size = np.sin(np.pi * np.clip(since, 0.0, 1.0))
    noise = np.random.default_rng(0).normal(size=q.shape) * NOISE
    motion = SimpleNamespace(t=t, q=q)
    scene = SimpleNamespace(motion=motion, slides=np.ones(q.shape, dtype=bool))
    left = noise - size[:, None] * (turning @ force)
    return SimpleNamespace(
        ground=SimpleNamespace(stage=SimpleNamespace(scenes=[scene])),
        model=SimpleNamespace(
            left=lambda: [left],
            noise=SimpleNamespace(sigma=np.full(ROBOT.n, NOISE)),
        ),
    )


@pytest.mark.parametrize("way", [[20.0, 5.0, -10.0], [0.0, -30.0, 5.0]])
def test_point_and_force_of_a_push_are_told(way: list[float]) -> None:
    point, force = np.array([0.05, -0.12, 0.2]), np.array(way)
    found = contact_point(pushed(point, force, 3), ROBOT, PUSH)
    assert found.after_joint == ROBOT.joint_names[3]
    np.testing.assert_allclose(found.point, point, atol=0.02)
    errors = (np.array(found.point) - point) / np.array(found.std_error)
    assert np.all(np.abs(errors) < 4.0)
    assert found.force == pytest.approx(np.linalg.norm(force), rel=0.1)


def test_one_joint_alone_tells_no_point() -> None:
    one = replace(PUSH, joints=(0,))
    found = pushed(np.zeros(3), np.array([20.0, 5.0, 0.0]), 0)
    assert contact_point(found, ROBOT, one) is None


def test_what_no_force_explains_has_no_point() -> None:
    found = pushed(np.zeros(3), np.zeros(3), 3)
    assert contact_point(found, ROBOT, PUSH) is None
