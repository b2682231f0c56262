"""A motion that is recorded again says what it said once, with less noise."""

import numpy as np
import pytest

from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.regression.repeats import with_log
from seqid_cli.typing import Array

BLOCKS, ROWS, SIZE = 40, 50, 4
THETA = np.array([1.0, -2.0, 0.5, 3.0])


def motion(seed: int) -> Array:
    """Columns (N, p) of a log, slow against its rows."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, BLOCKS * ROWS)
    waves = [
        sum(
            np.sin(2 * np.pi * rng.uniform(2, 60) * t + rng.uniform(0, 6))
            for _ in "abc"
        )
        for _ in range(SIZE)
    ]
    return np.column_stack(waves)


def log(
    H: Array, *, missing: float, noise: float, seed: int, blurred: float = 0.002
) -> list[Accumulator]:
    """Rows of two joints: `missing` comes with the motion, `noise` is new each time."""
    rng = np.random.default_rng(seed)
    lacked = missing * np.tanh(3.0 * H[:, 0] * H[:, 1])
    joints = []
    for scale in (1.0, 2.0):
        # A drive and its encoder are never twice the same to the last digit.
        moved = H * scale + rng.normal(0.0, blurred, H.shape)
        y = moved @ THETA + lacked + rng.normal(0.0, noise, len(H))
        joint = Accumulator(SIZE)
        for rows in np.split(np.arange(len(H)), BLOCKS):
            joint.add(moved[rows], y[rows])
        joints.append(joint)
    return joints


def std_errors(logs: list[list[Accumulator]]) -> Array:
    joints = [Accumulator(SIZE) for _ in logs[0]]
    for one in logs:
        joints = with_log(joints, one)
    return np.sqrt(np.diag(solve(joints).covariance))


def test_what_comes_with_the_motion_does_not_average_out() -> None:
    H = motion(0)
    logs = [log(H, missing=1.0, noise=0.01, seed=k) for k in range(9)]
    once = std_errors(logs[:1])
    np.testing.assert_allclose(std_errors(logs), once, rtol=0.05)


def test_noise_averages_out() -> None:
    H = motion(0)
    logs = [log(H, missing=0.0, noise=1.0, seed=k) for k in range(9)]
    ratio = std_errors(logs) / std_errors(logs[:1])
    np.testing.assert_allclose(ratio, 1.0 / 3.0, rtol=0.35)


def test_other_motions_count_by_themselves() -> None:
    """Also where a repeated motion lies between them."""
    logs = [log(motion(k), missing=1.0, noise=0.01, seed=k) for k in range(8)]
    joints = [Accumulator(SIZE) for _ in "ab"]
    for one in (*logs, *logs[2:5]):
        joints = with_log(joints, one)
    assert len(joints[0].blocks) <= 8 * BLOCKS
    assert joints[0].samples == 11 * BLOCKS * ROWS
    ratio = std_errors(logs) / std_errors(logs[:1])
    assert np.median(ratio) == pytest.approx(8**-0.5, rel=0.4)


def test_rows_are_the_same_as_those_of_all_logs() -> None:
    H = motion(0)
    logs = [log(H, missing=1.0, noise=0.1, seed=k) for k in range(3)]
    together = [Accumulator(SIZE) for _ in "ab"]
    for one in logs:
        together = with_log(together, one)
    for joint, parts in zip(together, zip(*logs, strict=True), strict=True):
        products = sum(part.total.T @ part.total for part in parts)
        np.testing.assert_allclose(joint.total.T @ joint.total, products, rtol=1e-9)
        assert len(joint.blocks) == BLOCKS


def test_logs_that_are_cut_otherwise_are_new() -> None:
    """The same motion, begun a while later."""
    H = motion(0)
    later = np.roll(H, 8 * ROWS + 20, axis=0)
    logs = [log(x, missing=0.0, noise=0.1, seed=k) for k, x in enumerate((H, later))]
    joints = with_log(*logs)
    assert len(joints[0].blocks) == 2 * BLOCKS


def test_columns_count_alike_whatever_their_units() -> None:
    """A small column that is another makes another motion, as a large one does."""
    H = motion(0) * (1.0, 1.0, 1.0, 1e-3)
    other = H.copy()
    other[:, 3] = motion(1)[:, 3] * 1e-3
    quiet = {"missing": 0.0, "noise": 0.1}
    first, same, differs = (
        log(x, seed=seed, blurred=0.0, **quiet) for seed, x in enumerate((H, H, other))
    )
    assert len(with_log(first, same)[0].blocks) == BLOCKS
    assert len(with_log(first, differs)[0].blocks) == 2 * BLOCKS


def test_a_motion_of_the_same_speed_that_is_coordinated_otherwise_is_another() -> None:
    """Columns have the same squares; a fifth of one's motion is the other's."""
    H = motion(0)
    other = H.copy()
    other[:, 0] = np.cos(0.4) * H[:, 0] + np.sin(0.4) * H[:, 1]
    other[:, 0] *= np.linalg.norm(H[:, 0]) / np.linalg.norm(other[:, 0])
    joints = with_log(*(log(x, missing=0.0, noise=0.1, seed=0) for x in (H, other)))
    assert len(joints[0].blocks) == 2 * BLOCKS


def test_an_arm_of_one_joint_repeats_its_motion_as_well() -> None:
    H = motion(0)
    first, again = (log(H, missing=0.0, noise=0.1, seed=k)[:1] for k in range(2))
    (joint,) = with_log(first, again)
    assert len(joint.blocks) == BLOCKS
    assert joint.samples == 2 * BLOCKS * ROWS


def test_blocks_of_other_lengths_are_not_compared() -> None:
    logs = [log(motion(0), missing=0.0, noise=0.1, seed=k) for k in range(2)]
    for joint in logs[0]:
        joint._halve()
    joints = with_log(*logs)
    assert [len(joint.blocks) for joint in joints] == [BLOCKS, BLOCKS]
    assert joints[0].samples == 2 * BLOCKS * ROWS
