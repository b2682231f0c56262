"""Accumulated factors against numpy's least squares on the stacked regressor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.identify.regression.least_squares import (
    MOST_BLOCKS,
    Accumulator,
    Prior,
    solve,
    triangular,
    whitened,
)

Array = NDArray[np.float64]

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
    solution: Array = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return solution


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


def test_joints_are_weighted_by_their_noise() -> None:
    got = solve([j.accumulated() for j in make(np.random.default_rng(1))])
    np.testing.assert_allclose(got.sigma, NOISES, rtol=0.1)
    white = np.sqrt(np.diag(got.bread))
    quiet = solve([make(np.random.default_rng(1))[0].accumulated()])
    assert (white < np.sqrt(np.diag(quiet.bread))).all()


def test_the_bread_is_the_inverse_normal_matrix() -> None:
    joints = make(np.random.default_rng(2))
    got = solve([j.accumulated() for j in joints], iterations=20)
    normal = sum(j.H.T @ j.H / s**2 for j, s in zip(joints, got.sigma, strict=True))
    np.testing.assert_allclose(got.bread @ normal, np.eye(P), atol=1e-8)


def test_the_order_of_blocks_does_not_matter() -> None:
    joints = make(np.random.default_rng(3))
    order = np.random.default_rng(4).permutation(12).tolist()
    plain = solve([j.accumulated() for j in joints])
    mixed = solve([j.accumulated(order) for j in joints])
    np.testing.assert_allclose(mixed.theta, plain.theta, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(mixed.covariance, plain.covariance, rtol=1e-8, atol=1e-16)


def test_the_factor_does_not_know_how_rows_were_cut() -> None:
    joint = make(np.random.default_rng(5))[0]
    once = Accumulator(P)
    once.add(joint.H, joint.y)
    np.testing.assert_allclose(joint.accumulated().total, once.total, rtol=1e-9, atol=1e-9)
    assert joint.accumulated().samples == once.samples == len(joint.y)


def test_the_same_rows_give_the_same_bits() -> None:
    joints = make(np.random.default_rng(6))
    one, two = (solve([j.accumulated() for j in joints]) for _ in range(2))
    np.testing.assert_array_equal(one.theta, two.theta)
    np.testing.assert_array_equal(one.covariance, two.covariance)


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


def test_empty_blocks_keep_joints_in_step() -> None:
    joints = make(np.random.default_rng(8))
    accumulated = [j.accumulated() for j in joints]
    idle = Accumulator(P)
    for _ in range(12):
        idle.add(np.zeros((0, P)), np.zeros(0))
    with_idle = solve([*accumulated, idle])
    np.testing.assert_allclose(with_idle.theta, solve(accumulated).theta, rtol=1e-12)


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


def test_scaled_units_do_not_change_what_is_determined() -> None:
    joints = make(np.random.default_rng(10))
    factor = 10.0 ** np.array([-3, 3, 0, 2, -2, 1, 1])
    scaled = [Joint([(H * factor, y) for H, y in j.blocks]) for j in joints]
    plain, other = (solve([j.accumulated() for j in group]) for group in (joints, scaled))
    np.testing.assert_allclose(other.theta * factor, plain.theta, rtol=1e-8)
    np.testing.assert_array_equal(other.determined, plain.determined)
    assert other.condition == pytest.approx(plain.condition, rel=1e-6)


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


def test_residual_rms_needs_no_rows() -> None:
    joint = make(np.random.default_rng(15))[0]
    theta = THETA + 0.1
    expected = np.sqrt(np.mean((joint.H @ theta - joint.y) ** 2))
    assert joint.accumulated().residual_rms(theta) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("rows", [0, 1, 3, 4, 50])
def test_a_triangular_factor_keeps_the_gram_matrix(rows: int) -> None:
    A = np.random.default_rng(rows).standard_normal((rows, 4))
    R = triangular(A)
    assert R.shape == (4, 4)
    assert (np.diag(R) >= 0).all()
    assert not np.tril(R, -1).any()
    np.testing.assert_allclose(R.T @ R, A.T @ A, atol=1e-12)


def test_whitened_rows_carry_the_inverse_covariance() -> None:
    B = np.random.default_rng(16).standard_normal((5, 5))
    covariance = B @ B.T
    L = whitened(covariance)
    np.testing.assert_allclose(L.T @ L, np.linalg.inv(covariance), rtol=1e-7)
    singular = whitened(np.diag([4.0, 0.0]))
    np.testing.assert_allclose(singular.T @ singular, np.diag([0.25, 0.0]), atol=1e-12)


def test_a_column_of_zeros_can_be_taken_out() -> None:
    rng = np.random.default_rng(22)
    full = rng.normal(size=(40, 31))
    full[:, [0, 7, 29]] = 0.0
    joint = Accumulator(30)
    joint.add(full[:, :-1], full[:, -1])
    kept, less = joint.with_fixed(7, 0.0).blocks[0], np.delete(full, 7, axis=1)
    np.testing.assert_allclose(kept.T @ kept, less.T @ less, atol=1e-11)


def test_rows_can_be_chosen_by_a_mask() -> None:
    rng = np.random.default_rng(23)
    H, y, where = rng.normal(size=(90, 5)), rng.normal(size=90), rng.random(90) < 0.6
    some, chosen = Accumulator(5), Accumulator(5)
    some.add(H, y, where)
    chosen.add(H[where], y[where])
    np.testing.assert_array_equal(some.total, chosen.total)
    assert some.samples == int(where.sum())


def test_blocks_of_a_long_log_hold_the_same_number_of_rows() -> None:
    """Up to the last one, or the jackknife would weigh the end of a log like its beginning."""
    rng = np.random.default_rng(24)
    joint = Accumulator(2)
    for _ in range(5 * MOST_BLOCKS + 3):
        joint.add(rng.normal(size=(3, 2)), rng.normal(size=3))
    assert len(joint.blocks) > MOST_BLOCKS // 2
    assert len(set(joint.rows[:-1])) == 1
    assert 0 < joint.rows[-1] <= joint.rows[0]


def test_columns_that_come_later_and_merged_factors_keep_the_gram_matrix() -> None:
    rng = np.random.default_rng(25)
    early, late = rng.normal(size=(2, 40, 20))
    early[:, 5:9] = late[:, 12:] = 0.0
    y = rng.normal(size=(2, 40))
    one = Accumulator(20, span=2)
    one.add(early, y[0])
    one.add(late, y[1])
    two = Accumulator(20)
    two.add(early, y[0])
    two.add(late, y[1])
    assert (len(one.blocks), len(two.blocks)) == (1, 2)
    full = np.column_stack([np.vstack([early, late]), y.ravel()])
    for joint in (one, two, Accumulator(20) + two):
        np.testing.assert_allclose(joint.total.T @ joint.total, full.T @ full, atol=1e-11)


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
