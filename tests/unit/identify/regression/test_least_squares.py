"""Accumulated factors against numpy's least squares on the stacked regressor."""

from dataclasses import dataclass

import numpy as np
import pytest

from seqid_cli.identify.regression.least_squares import (
    MOST_BLOCKS,
    Accumulator,
    Prior,
    solve,
    whitened,
)
from tests import Array

P = 7
NOISES = (0.1, 2.0, 0.5)


@dataclass(frozen=True)
class Joint:
    """Rows of one joint, in blocks."""

    blocks: list[tuple[Array, Array]]

    @property
    def H(self) -> Array:  # noqa: N802
        return np.vstack([H for H, _ in self.blocks])

    @property
    def y(self) -> Array:
        return np.concatenate([y for _, y in self.blocks])

    def accumulated(self, order: list[int] | None = None) -> Accumulator:
        joint = Accumulator(self.H.shape[1])
        for k in order or range(len(self.blocks)):
            joint.add(*self.blocks[k])
        return joint


THETA = np.array([3.0, -1.0, 0.02, 5.0, 0.0, 0.4, -7.0])
SCALES = np.array([1.0, 0.01, 30.0, 2.0, 1.0, 5.0, 0.1])


def make(rng: np.random.Generator, *, blocks: int = 12, rows: int = 40) -> list[Joint]:
    """Three joints of different noise, columns of very different size."""
    joints = []
    for noise in NOISES:
        parts = []
        for _ in range(blocks):
            H = rng.standard_normal((rows, P)) * SCALES
            parts.append((H, H @ THETA + noise * rng.standard_normal(rows)))
        joints.append(Joint(parts))
    return joints


def stacked(joints: list[Joint], sigma: Array, prior: Prior | None = None) -> Array:
    """The oracle: weighted rows on top of each other."""
    rows = [joint.H / s for joint, s in zip(joints, sigma, strict=True)]
    right = [joint.y / s for joint, s in zip(joints, sigma, strict=True)]
    if prior is not None:
        rows, right = [*rows, prior.A], [*right, prior.b]
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]


def test_the_solution_is_that_of_the_stacked_weighted_rows() -> None:
    joints = make(np.random.default_rng(0))
    got = solve([j.accumulated() for j in joints], iterations=20)
    np.testing.assert_allclose(got.theta, stacked(joints, got.sigma), rtol=1e-9, atol=1e-12)
    for joint, sigma in zip(joints, got.sigma, strict=True):
        off = joint.y - joint.H @ got.theta
        assert sigma == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
    assert got.rank == P
    assert got.determined.all()


@pytest.mark.parametrize("slow", [0.0, 0.5])
def test_slow_noise_counts_as_so_much_more_white_noise(slow: float) -> None:
    rng, blocks, rows = np.random.default_rng(2), 200, 40
    joint = Accumulator(1)
    for own in slow * rng.standard_normal(blocks):
        joint.add(np.ones((rows, 1)), 3.0 + own + rng.standard_normal(rows))
    expected = (1.0 + rows * slow**2) / (1.0 + slow**2)  # variance of a mean, over that of white
    assert solve([joint]).designs[0] == pytest.approx(expected, rel=0.3)


def test_memory_does_not_grow_with_the_log() -> None:
    rng = np.random.default_rng(7)
    joint, H_all, y_all = Accumulator(3), [], []
    for _ in range(3 * MOST_BLOCKS + 17):
        H = rng.standard_normal((5, 3))
        y = H @ [1.0, 2.0, 3.0] + 0.1 * rng.standard_normal(5)
        joint.add(H, y)
        H_all.append(H)
        y_all.append(y)
        assert len(joint.blocks) == len(joint.rows) <= MOST_BLOCKS
    assert {block.shape for block in joint.blocks} == {(4, 4)}
    expected = np.linalg.lstsq(np.vstack(H_all), np.concatenate(y_all), rcond=None)[0]
    np.testing.assert_allclose(solve([joint]).theta, expected, rtol=1e-10)
    assert joint.samples == 5 * (3 * MOST_BLOCKS + 17)


def test_what_cannot_be_told_apart_is_not_determined() -> None:
    """Columns 1 and 4 always together, column 2 absent: their values say nothing."""
    rng = np.random.default_rng(9)
    H = rng.standard_normal((600, P))
    H[:, 4] = 2.0 * H[:, 1]
    H[:, 2] = 0.0
    joint = Accumulator(P)
    for k in range(0, 600, 50):
        joint.add(H[k : k + 50], H[k : k + 50] @ THETA + 0.01 * rng.standard_normal(50))
    got = solve([joint])
    expected = np.ones(P, dtype=bool)
    expected[[1, 2, 4]] = False
    np.testing.assert_array_equal(got.determined, expected)
    assert got.rank == P - 2
    np.testing.assert_allclose(got.theta[expected], THETA[expected], atol=0.01)
    assert got.theta[1] + 2 * got.theta[4] == pytest.approx(THETA[1] + 2 * THETA[4], abs=0.01)
    assert got.theta[2] == 0.0
    assert np.isfinite(got.covariance).all()


def test_no_rows_determine_nothing() -> None:
    got = solve([Accumulator(3)])
    assert got.rank == 0
    assert not got.determined.any()
    assert not got.theta.any()


def test_a_prior_is_more_rows() -> None:
    rng = np.random.default_rng(11)
    joints = make(rng, blocks=4, rows=10)
    A = rng.standard_normal((3, P)) / SCALES * 4
    prior = Prior(A, A @ THETA + rng.standard_normal(3))
    got = solve([j.accumulated() for j in joints], prior=prior, iterations=20)
    np.testing.assert_allclose(got.theta, stacked(joints, got.sigma, prior), rtol=1e-7, atol=1e-9)


def test_a_prior_determines_what_the_rows_do_not() -> None:
    rng = np.random.default_rng(12)
    H = rng.standard_normal((300, 3))
    H[:, 2] = H[:, 1]
    noise = 1e-3 * rng.standard_normal(300)
    joint = Accumulator(3)
    for k in range(0, 300, 30):
        joint.add(H[k : k + 30], H[k : k + 30] @ [1.0, 2.0, 3.0] + noise[k : k + 30])
    assert not solve([joint]).determined[1:].any()
    got = solve([joint], prior=Prior(np.array([[0.0, 0.0, 1e3]]), np.array([3e3])))
    assert got.determined.all()
    np.testing.assert_allclose(got.theta, [1, 2, 3], atol=1e-3)


def test_a_prior_alone_keeps_its_covariance() -> None:
    """What no row touches comes out as certain as it went in."""
    rng = np.random.default_rng(13)
    B = rng.standard_normal((2, 2))
    covariance = B @ B.T
    rows = whitened(covariance)
    A = np.hstack([np.zeros((2, 3)), rows])
    value = np.array([4.0, -1.0])
    joint = Accumulator(5)
    for _ in range(30):
        H = np.hstack([rng.standard_normal((20, 3)), np.zeros((20, 2))])
        joint.add(H, H[:, :3] @ [1.0, 2.0, 3.0] + 0.1 * rng.standard_normal(20))
    got = solve([joint], prior=Prior(A, rows @ value))
    np.testing.assert_allclose(got.theta[3:], value, atol=1e-9)
    np.testing.assert_allclose(got.covariance[3:, 3:], covariance, rtol=0.1)


def test_holding_a_parameter_takes_its_column_out() -> None:
    joints = make(np.random.default_rng(14))
    held = [j.accumulated().with_fixed(3, 5.0) for j in joints]
    moved = [
        Joint([(np.delete(H, 3, axis=1), y - 5.0 * H[:, 3]) for H, y in j.blocks]) for j in joints
    ]
    got, expected = solve(held), solve([j.accumulated() for j in moved])
    np.testing.assert_allclose(got.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(got.covariance, expected.covariance, rtol=1e-6, atol=1e-15)


def test_blocks_of_a_long_log_hold_the_same_number_of_rows() -> None:
    """Up to the last one, or the jackknife would weigh the end of a log like its beginning."""
    rng = np.random.default_rng(24)
    joint = Accumulator(2)
    for _ in range(5 * MOST_BLOCKS + 3):
        joint.add(rng.normal(size=(3, 2)), rng.normal(size=3))
    assert len(joint.blocks) > MOST_BLOCKS // 2
    assert len(set(joint.rows[:-1])) == 1
    assert 0 < joint.rows[-1] <= joint.rows[0]


def test_more_samples_of_the_same_do_not_outweigh_the_prior() -> None:
    """Every row four times, a quarter of them independent: nothing changes."""
    rng = np.random.default_rng(12)
    H, y = rng.normal(size=(400, 3)), rng.normal(size=400)
    prior = Prior(np.diag([30.0, 0.0, 0.0]), np.array([15.0, 0.0, 0.0]))
    once, often = Accumulator(3), Accumulator(3)
    for start in range(0, 400, 40):
        rows = slice(start, start + 40)
        once.add(H[rows], y[rows])
        often.add(np.repeat(H[rows], 4, axis=0), np.repeat(y[rows], 4))
    expected = solve([once], prior=prior, iterations=8)
    found = solve([often], prior=prior, iterations=8, independent=0.25)
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    heavier = solve([often], prior=prior, iterations=8)
    assert abs(heavier.theta[0] - expected.theta[0]) > 1e-3
