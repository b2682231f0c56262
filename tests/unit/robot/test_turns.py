"""Turns by a vector are those of SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.robot.kinematics import one_turn, turned_by

RNG = np.random.default_rng(11)
DIRECTION = RNG.normal(size=3) / np.sqrt(3.0)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 1.0, 3.0, 3.1415])
def test_turns_are_rotations(size: float) -> None:
    turn = size * DIRECTION
    expected = Rotation.from_rotvec(turn).as_matrix()
    np.testing.assert_allclose(turned_by(turn), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_one_turn_is_both(size: float) -> None:
    first = RNG.normal(size=3)
    then = size * DIRECTION
    both = Rotation.from_rotvec(then) * Rotation.from_rotvec(first)
    np.testing.assert_allclose(
        one_turn(first, then), both.as_rotvec(), rtol=0, atol=1e-13
    )


def test_turn_and_back_is_none() -> None:
    np.testing.assert_allclose(one_turn(DIRECTION, -DIRECTION), 0.0, atol=1e-15)
