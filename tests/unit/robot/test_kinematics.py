"""Kinematics against Pinocchio and against the paper's own matrices."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from seqid_cli.robot.kinematics import (
    chain_from_dh,
    forward,
    link_angular_motion,
    rotation_about,
    tidy_position,
    tidy_rotation,
)
from seqid_cli.robot.types import Array
from tests.plants.robots.small import random_model, states

MIXED = [False, True, False, False]


def test_frames_and_angular_motion_are_pinocchios() -> None:
    model, chain = random_model(np.random.default_rng(0), MIXED)
    q, dq, ddq = states(np.random.default_rng(1), 5, 4)
    frames, data = forward(chain, q), model.createData()
    turns = [link_angular_motion(chain, q, dq, ddq, link) for link in range(4)]
    for k in range(5):
        pin.forwardKinematics(model, data, q[k], dq[k], ddq[k])
        for i, (w, dw) in enumerate(turns):
            placement = data.oMi[i + 1]
            np.testing.assert_allclose(frames.R[k, i], placement.rotation, atol=1e-12)
            np.testing.assert_allclose(frames.p[k, i], placement.translation, atol=1e-12)
            np.testing.assert_allclose(frames.z[k, i], placement.rotation @ chain.axis[i])
            np.testing.assert_allclose(w[k], data.v[i + 1].angular, atol=1e-12)
            np.testing.assert_allclose(dw[k], data.a[i + 1].angular, atol=1e-12)


def test_dh_frames_are_products_of_the_four_moves() -> None:
    rows = [(0.3, 0.2, 0.5, -0.7), (-1.1, 0.1, 0.4, 0.9)]
    q = np.array([0.6, 0.25])
    moved = [(0.3, 0.2, 0.5, -0.7 + q[0]), (-1.1, 0.1, 0.4 + q[1], 0.9)]
    T = np.eye(4)
    for alpha, a, d, theta in moved:
        T = T @ _move([1, 0, 0], alpha, a) @ _move([0, 0, 1], theta, d)
    frames = forward(chain_from_dh(rows, [1]), q[None])
    np.testing.assert_allclose(frames.R[0, 1], T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(frames.p[0, 1], T[:3, 3], atol=1e-14)


def _move(axis: list[int], angle: float, slide: float) -> Array:
    T = np.eye(4)
    T[:3, :3] = rotation_about(np.array(axis, dtype=float), angle)
    T[:3, 3] = slide * np.array(axis)
    return T


@pytest.mark.parametrize("angle", [1.5708, 1.570796, -1.5708, 3.14159])
def test_rounded_quarter_turns_become_exact(angle: float) -> None:
    R = tidy_rotation(rotation_about(np.array([1.0, 0.0, 0.0]), angle))
    assert set(np.unique(R)) <= {-1.0, 0.0, 1.0}
    skewed = R @ rotation_about(np.array([0.0, 0.0, 1.0]), 0.3)
    np.testing.assert_allclose(tidy_rotation(skewed), skewed, atol=1e-15)


def test_real_misalignment_is_kept() -> None:
    R = rotation_about(np.array([1.0, 0.0, 0.0]), 1e-4)
    np.testing.assert_allclose(tidy_rotation(R), R, atol=1e-8)
    assert abs(tidy_rotation(R)[1, 2]) > 0.99e-4
    np.testing.assert_array_equal(tidy_position(np.array([1e-5, 4e-17, -0.2])), [1e-5, 0.0, -0.2])
