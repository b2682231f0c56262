"""Accumulated factors and their solution against numpy's least squares on all rows."""

import numpy as np
import pytest

from seqid_cli.identify.regression.least_squares import (
    MOST_BLOCKS,
    Accumulator,
    Prior,
    _filled_columns,
    solve,
    spread_of,
    triangular,
)
from seqid_cli.identify.regression.least_squares import whitened as rows_of
from tests import Array

NOISES = (0.1, 2.0, 0.5)
THETA = np.array([3.0, -1.0, 0.02, 5.0, 0.0, 0.4, -7.0])
SCALES = np.array([1.0, 0.01, 30.0, 2.0, 1.0, 5.0, 0.1])
P = len(THETA)


def accumulated(H: Array, y: Array, rows: int = 40) -> Accumulator:
    joint = Accumulator(H.shape[1])
    for start in range(0, len(y), rows):
        joint.add(H[start : start + rows], y[start : start + rows])
    return joint


def of(
    H: Array, theta: Array, noise: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    return H, H @ theta + noise * rng.standard_normal(len(H))


@pytest.mark.parametrize("known", [False, True])
def test_the_solution_is_that_of_the_stacked_weighted_rows(*, known: bool) -> None:
    rng, shape = np.random.default_rng(11), (40 if known else 480, P)
    # Three joints of different noise, columns of very different size.
    joints = [
        of(rng.standard_normal(shape) * SCALES, THETA, noise, rng) for noise in NOISES
    ]
    A = rng.standard_normal((3, P)) / SCALES * 4
    prior = Prior(A=A, b=A @ THETA + rng.standard_normal(3))
    given = prior if known else None
    got = solve([accumulated(*j, rows=10) for j in joints], prior=given, iterations=20)
    rows = [
        np.column_stack([H, y]) / s for (H, y), s in zip(joints, got.sigma, strict=True)
    ]
    rows += [np.column_stack([prior.A, prior.b])] * known
    stacked = np.vstack(rows)
    expected = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]
    rtol, atol = (1e-7, 1e-9) if known else (1e-9, 1e-12)
    np.testing.assert_allclose(got.theta, expected, rtol=rtol, atol=atol)
    for (H, y), sigma in zip(joints, got.sigma, strict=True):
        assert sigma == pytest.approx(
            np.sqrt(np.mean((y - H @ got.theta) ** 2)), rel=1e-9
        )
    assert got.rank == P
    assert got.determined.all()


def test_memory_does_not_grow_with_the_log() -> None:
    """Blocks hold the same number of rows up to the last, or the jackknife would weigh
    its end.
    """
    rng = np.random.default_rng(7)
    H, y = of(
        rng.standard_normal((5 * (5 * MOST_BLOCKS + 3), 3)),
        np.arange(1.0, 4.0),
        0.1,
        rng,
    )
    joint = Accumulator(3)
    for start in range(0, len(y), 5):
        joint.add(H[start : start + 5], y[start : start + 5])
        assert len(joint.blocks) == len(joint.rows) <= MOST_BLOCKS
    assert {block.shape for block in joint.blocks} == {(4, 4)}
    np.testing.assert_allclose(
        solve([joint]).theta, np.linalg.lstsq(H, y)[0], rtol=1e-10
    )
    assert joint.samples == len(y)
    assert len(joint.blocks) > MOST_BLOCKS // 2
    assert len(set(joint.rows[:-1])) == 1
    assert 0 < joint.rows[-1] <= joint.rows[0]


def test_what_cannot_be_told_apart_is_not_determined() -> None:
    """Columns 1 and 4 always together, column 2 absent: their values say nothing."""
    rng = np.random.default_rng(9)
    H = rng.standard_normal((600, P))
    H[:, 4] = 2.0 * H[:, 1]
    H[:, 2] = 0.0
    got = solve([accumulated(*of(H, THETA, 0.01, rng))])
    expected = ~np.isin(np.arange(P), [1, 2, 4])
    np.testing.assert_array_equal(got.determined, expected)
    assert got.rank == P - 2
    np.testing.assert_allclose(got.theta[expected], THETA[expected], atol=0.01)
    assert got.theta[1] + 2 * got.theta[4] == pytest.approx(
        THETA[1] + 2 * THETA[4], abs=0.01
    )
    assert got.theta[2] == 0.0
    assert np.isfinite(got.covariance).all()
    nothing = solve([Accumulator(3)])
    assert nothing.rank == 0
    assert not np.any([nothing.determined, nothing.theta])


def test_moves_along_open_directions_change_no_torque() -> None:
    rng = np.random.default_rng(9)
    H = rng.standard_normal((600, P)) * SCALES
    H[:, 4] = 3.0 * H[:, 1]
    H[:, 2] = 0.0
    left_open = solve([accumulated(*of(H, THETA, 0.01, rng))]).left_open
    assert np.linalg.matrix_rank(left_open) == 2
    np.testing.assert_allclose(H @ left_open, 0.0, atol=1e-12)


def test_a_column_of_rounding_alone_determines_nothing() -> None:
    rng = np.random.default_rng(15)
    H = rng.standard_normal((600, P))
    H[:, 2] *= 1e-13
    got = solve([accumulated(*of(H, THETA, 0.01, rng))])
    np.testing.assert_array_equal(got.determined, np.arange(P) != 2)
    assert got.theta[2] == 0.0


@pytest.mark.parametrize("size", [1e-20, 1.0, 1e20])
def test_a_covariance_in_any_unit_makes_a_prior(size: float) -> None:
    covariance = size * np.array([[2.0, 0.6], [0.6, 0.5]])
    L = rows_of(covariance)
    np.testing.assert_allclose(L.T @ L, np.linalg.inv(covariance), rtol=1e-9)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_what_is_rounding_goes_by_the_largest_column(size: float) -> None:
    filled = _filled_columns(size * np.array([[1.0, 1e-12, 1e-6]]))
    assert filled.tolist() == [True, False, True]


def test_the_jackknife_counts_its_blocks() -> None:
    """G moves have (G - 1) / G of the sum of their squares; a single one has all."""
    assert spread_of(np.array([[2.0]])).tolist() == [[4.0]]
    assert spread_of(np.array([[2.0], [-2.0]])).tolist() == [[4.0]]
    assert spread_of(np.array([[2.0], [-2.0], [0.0], [0.0]])).tolist() == [[6.0]]


@pytest.mark.parametrize("quiet", [1e-3, 1e-7, 1e-11])
def test_a_quiet_joint_hides_no_parameters_of_a_loud_one(quiet: float) -> None:
    rng = np.random.default_rng(11)
    loud, other = rng.normal(size=(480, P)), rng.normal(size=(480, P))
    other[:, :4] = 0.0  # a wrist does not feel what is before it
    joints = [of(loud, THETA, 0.3, rng), of(other, THETA, quiet, rng)]
    got = solve([accumulated(*joint) for joint in joints])
    assert got.determined.all()
    np.testing.assert_allclose(got.theta[:4], THETA[:4], atol=0.1)
    np.testing.assert_allclose(got.theta[4:], THETA[4:], atol=10.0 * quiet)
    assert got.sigma[0] == pytest.approx(0.3, rel=0.15)


def test_noise_that_comes_four_times_counts_as_four_times_the_noise() -> None:
    """White noise has a design of one; with its motion repeated, of four."""
    rng = np.random.default_rng(16)
    H, y = of(rng.standard_normal((2400, 3)), THETA[:3], 0.5, rng)
    once = solve([accumulated(H, y)]).designs
    often = accumulated(np.repeat(H, 4, axis=0), np.repeat(y, 4), rows=160)
    np.testing.assert_allclose(once, 1.0, rtol=0.3)
    np.testing.assert_allclose(solve([often]).designs, 4.0 * once, rtol=1e-2)


def test_a_factor_has_the_products_of_its_rows_and_no_negative_diagonal() -> None:
    rows = np.random.default_rng(18).standard_normal((40, 5))
    rows[:, 2] = 0.0
    R = triangular(rows)
    np.testing.assert_allclose(R.T @ R, rows.T @ rows, atol=1e-12)
    np.testing.assert_array_equal(R, np.triu(R))
    assert (R.diagonal() >= 0.0).all()


def test_nuisances_are_determined_by_their_prior_alone() -> None:
    """Among them one that is hardly told apart from a parameter by the rows."""
    rng = np.random.default_rng(19)
    H = rng.standard_normal((480, 5))
    H[:, 3] = H[:, 0] + 1e-5 * rng.standard_normal(480)
    y = H @ THETA[:5] + 0.1 * rng.standard_normal(480)
    A = np.zeros((2, 5))
    A[:, 3:] = np.diag([20.0, 5.0])
    prior = Prior(A=A, b=A @ THETA[:5] + rng.standard_normal(2))
    got = solve([accumulated(H, y)], prior=prior, iterations=20, nuisances=slice(3, 5))
    stacked = np.vstack(
        [np.column_stack([H, y]) / got.sigma, np.column_stack([A, prior.b])]
    )
    X, z = stacked[:, :-1], stacked[:, -1]
    np.testing.assert_allclose(got.theta, np.linalg.lstsq(X, z)[0], rtol=1e-6)
    np.testing.assert_allclose(got.bread, np.linalg.inv(X.T @ X), rtol=1e-6, atol=1e-9)
    assert got.determined.all()
    assert got.rank == 3


def test_a_parameter_that_is_held_leaves_the_others_to_be_solved_for() -> None:
    rng = np.random.default_rng(17)
    H, y = of(rng.standard_normal((480, P)), THETA, 0.1, rng)
    held = accumulated(H, y).with_fixed(2, 0.7)
    others = np.delete(H, 2, axis=1)
    left = y - 0.7 * H[:, 2]
    got = solve([held])
    expected = solve([accumulated(others, left)])
    np.testing.assert_allclose(got.theta, np.linalg.lstsq(others, left)[0], rtol=1e-9)
    np.testing.assert_allclose(got.covariance, expected.covariance, rtol=1e-7)


def test_a_prior_alone_keeps_its_covariance() -> None:
    rng = np.random.default_rng(13)
    B, value = rng.standard_normal((2, 2)), np.array([4.0, -1.0])
    rows = rows_of(B @ B.T)
    H = np.hstack([rng.standard_normal((600, 3)), np.zeros((600, 2))])
    joint = accumulated(*of(H, np.arange(1.0, 6.0), 0.1, rng), rows=20)
    got = solve(
        [joint], prior=Prior(A=np.hstack([np.zeros((2, 3)), rows]), b=rows @ value)
    )
    np.testing.assert_allclose(got.theta[3:], value, atol=1e-9)
    np.testing.assert_allclose(got.covariance[3:, 3:], B @ B.T, rtol=0.1)


def test_more_samples_of_the_same_do_not_outweigh_the_prior() -> None:
    """Every row four times, a quarter of them independent: nothing changes."""
    rng = np.random.default_rng(12)
    H, y = rng.normal(size=(400, 3)), rng.normal(size=400)
    prior = Prior(A=np.diag([30.0, 0.0, 0.0]), b=np.array([15.0, 0.0, 0.0]))
    often = accumulated(np.repeat(H, 4, axis=0), np.repeat(y, 4), rows=160)
    expected = solve([accumulated(H, y)], prior=prior, iterations=8)
    found = solve([often], prior=prior, iterations=8, independent=0.25)
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    heavier = solve([often], prior=prior, iterations=8)
    assert abs(heavier.theta[0] - expected.theta[0]) > 1e-3
