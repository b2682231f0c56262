"""Accumulated factors and their solution against numpy's least squares on the stacked regressor."""

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

NOISES = (0.1, 2.0, 0.5)
THETA = np.array([3.0, -1.0, 0.02, 5.0, 0.0, 0.4, -7.0])
SCALES = np.array([1.0, 0.01, 30.0, 2.0, 1.0, 5.0, 0.1])
P = len(THETA)
WIDTH, ROWS, BLOCKS = 24, 400, 12  # of large systems

Rows = tuple[Array, Array]  # H (N, p), y (N,)


def accumulated(H: Array, y: Array, rows: int = 40) -> Accumulator:
    joint = Accumulator(H.shape[1])
    for start in range(0, len(y), rows):
        joint.add(H[start : start + rows], y[start : start + rows])
    return joint


def of(H: Array, theta: Array, noise: float, rng: np.random.Generator) -> Rows:
    return H, H @ theta + noise * rng.standard_normal(len(H))


def make(rng: np.random.Generator, *, rows: int = 480) -> list[Rows]:
    """Three joints of different noise, columns of very different size."""
    return [of(rng.standard_normal((rows, P)) * SCALES, THETA, noise, rng) for noise in NOISES]


def stacked(joints: list[Rows], sigma: Array, prior: Prior | None = None) -> Array:
    """The oracle: weighted rows on top of each other."""
    rows = [H / s for (H, _), s in zip(joints, sigma, strict=True)]
    right = [y / s for (_, y), s in zip(joints, sigma, strict=True)]
    if prior is not None:
        rows, right = [*rows, prior.A], [*right, prior.b]
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]


@pytest.mark.parametrize("known", [False, True])
def test_the_solution_is_that_of_the_stacked_weighted_rows(*, known: bool) -> None:
    rng = np.random.default_rng(11)
    joints = make(rng, rows=40 if known else 480)
    A = rng.standard_normal((3, P)) / SCALES * 4
    prior = Prior(A, A @ THETA + rng.standard_normal(3)) if known else None
    got = solve([accumulated(*j, rows=10) for j in joints], prior=prior, iterations=20)
    rtol, atol = (1e-7, 1e-9) if known else (1e-9, 1e-12)
    np.testing.assert_allclose(got.theta, stacked(joints, got.sigma, prior), rtol=rtol, atol=atol)
    for (H, y), sigma in zip(joints, got.sigma, strict=True):
        assert sigma == pytest.approx(np.sqrt(np.mean((y - H @ got.theta) ** 2)), rel=1e-9)
    assert got.rank == P
    assert got.determined.all()


@pytest.mark.parametrize("slow", [0.0, 0.5])
def test_slow_noise_counts_as_so_much_more_white_noise(slow: float) -> None:
    rng, blocks, rows = np.random.default_rng(2), 200, 40
    offsets = np.repeat(slow * rng.standard_normal(blocks), rows)
    y = 3.0 + offsets + rng.standard_normal(len(offsets))
    joint = accumulated(np.ones((len(y), 1)), y, rows=rows)
    expected = (1.0 + rows * slow**2) / (1.0 + slow**2)  # variance of a mean, over that of white
    assert solve([joint]).designs[0] == pytest.approx(expected, rel=0.3)


def test_memory_does_not_grow_with_the_log() -> None:
    """Blocks hold the same number of rows up to the last, or the jackknife would weigh its end."""
    rng = np.random.default_rng(7)
    H, y = of(rng.standard_normal((5 * (5 * MOST_BLOCKS + 3), 3)), np.arange(1.0, 4.0), 0.1, rng)
    joint = Accumulator(3)
    for start in range(0, len(y), 5):
        joint.add(H[start : start + 5], y[start : start + 5])
        assert len(joint.blocks) == len(joint.rows) <= MOST_BLOCKS
    assert {block.shape for block in joint.blocks} == {(4, 4)}
    np.testing.assert_allclose(solve([joint]).theta, np.linalg.lstsq(H, y)[0], rtol=1e-10)
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
    expected = np.ones(P, dtype=bool)
    expected[[1, 2, 4]] = False
    np.testing.assert_array_equal(got.determined, expected)
    assert got.rank == P - 2
    np.testing.assert_allclose(got.theta[expected], THETA[expected], atol=0.01)
    assert got.theta[1] + 2 * got.theta[4] == pytest.approx(THETA[1] + 2 * THETA[4], abs=0.01)
    assert got.theta[2] == 0.0
    assert np.isfinite(got.covariance).all()


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


def test_no_rows_determine_nothing() -> None:
    got = solve([Accumulator(3)])
    assert got.rank == 0
    assert not got.determined.any()
    assert not got.theta.any()


def test_a_prior_determines_what_the_rows_do_not() -> None:
    rng = np.random.default_rng(12)
    H = rng.standard_normal((300, 3))
    H[:, 2] = H[:, 1]
    joint = accumulated(*of(H, np.arange(1.0, 4.0), 1e-3, rng), rows=30)
    assert not solve([joint]).determined[1:].any()
    got = solve([joint], prior=Prior(np.array([[0.0, 0.0, 1e3]]), np.array([3e3])))
    assert got.determined.all()
    np.testing.assert_allclose(got.theta, [1, 2, 3], atol=1e-3)


def test_a_prior_alone_keeps_its_covariance() -> None:
    """What no row touches comes out as certain as it went in."""
    rng = np.random.default_rng(13)
    B, value = rng.standard_normal((2, 2)), np.array([4.0, -1.0])
    rows = whitened(B @ B.T)
    H = np.hstack([rng.standard_normal((600, 3)), np.zeros((600, 2))])
    joint = accumulated(*of(H, np.arange(1.0, 6.0), 0.1, rng), rows=20)
    got = solve([joint], prior=Prior(np.hstack([np.zeros((2, 3)), rows]), rows @ value))
    np.testing.assert_allclose(got.theta[3:], value, atol=1e-9)
    np.testing.assert_allclose(got.covariance[3:, 3:], B @ B.T, rtol=0.1)


def test_holding_a_parameter_takes_its_column_out() -> None:
    joints = make(np.random.default_rng(14))
    got = solve([accumulated(*j).with_fixed(3, 5.0) for j in joints])
    moved = [(np.delete(H, 3, axis=1), y - 5.0 * H[:, 3]) for H, y in joints]
    expected = solve([accumulated(*j) for j in moved])
    np.testing.assert_allclose(got.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(got.covariance, expected.covariance, rtol=1e-6, atol=1e-15)


def test_more_samples_of_the_same_do_not_outweigh_the_prior() -> None:
    """Every row four times, a quarter of them independent: nothing changes."""
    rng = np.random.default_rng(12)
    H, y = rng.normal(size=(400, 3)), rng.normal(size=400)
    prior = Prior(np.diag([30.0, 0.0, 0.0]), np.array([15.0, 0.0, 0.0]))
    often = accumulated(np.repeat(H, 4, axis=0), np.repeat(y, 4), rows=160)
    expected = solve([accumulated(H, y)], prior=prior, iterations=8)
    found = solve([often], prior=prior, iterations=8, independent=0.25)
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    heavier = solve([often], prior=prior, iterations=8)
    assert abs(heavier.theta[0] - expected.theta[0]) > 1e-3


def solved(R: Array) -> Array:
    return np.asarray(np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=None)[0])


def off(R: Array, rows: Array) -> float:
    """How far R is from the factor of rows, against the largest entry of each column."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    R, rows = R / scale, rows / scale
    return float(np.abs(R.T @ R - rows.T @ rows).max())


@pytest.mark.parametrize("power", range(0, 13, 3))
def test_the_solution_is_as_good_as_lstsqs(power: int) -> None:
    """Of columns that depend on each other so far."""
    rng = np.random.default_rng(power)
    mixing = np.linalg.qr(rng.normal(size=(WIDTH, WIDTH)))[0]
    H = rng.normal(size=(ROWS * BLOCKS, WIDTH)) * np.logspace(0, -power, WIDTH) @ mixing
    theta = rng.normal(size=WIDTH)
    found = accumulated(H, H @ theta, ROWS).total
    exact = np.linalg.lstsq(H, H @ theta, rcond=1e-15)[0]
    rounding = 10.0**power * 1e-15 * np.linalg.norm(theta)
    limit = max(10.0 * np.linalg.norm(exact - theta), rounding)
    assert np.linalg.norm(solved(found) - theta) <= limit
    assert off(found, np.column_stack([H, H @ theta])) < 1e-11


@pytest.mark.parametrize("what", ["zero", "sum", "now and then", "nearly"])
def test_columns_that_tell_nothing_new(what: str) -> None:
    rng = np.random.default_rng(4)
    H = rng.normal(size=(ROWS * BLOCKS, WIDTH))
    if what == "zero":
        H[:, [0, 7, WIDTH - 1]] = 0.0
    elif what == "now and then":
        H[np.arange(len(H)) // ROWS % 3 == 1, 6] = 0.0
    else:
        H[:, 5] = H[:, 1] + (-2.0 * H[:, 3] if what == "sum" else 1e-9 * H[:, 5])
    y = H @ np.ones(WIDTH) + 1e-3 * rng.normal(size=len(H))
    joint = accumulated(H, y, ROWS)
    assert off(joint.total, np.column_stack([H, y])) < 1e-12
    for k, block in enumerate(joint.blocks):
        rows = slice(k * ROWS, (k + 1) * ROWS)
        assert off(block, np.column_stack([H[rows], y[rows]])) < 1e-11
        assert not block[:, :-1][:, ~H[rows].any(axis=0)].any()
        assert not np.tril(block, -1).any()
        assert (np.diag(block) >= 0.0).all()
    expected = np.linalg.lstsq(H, y, rcond=1e-12)[0]
    left = [np.linalg.norm(H @ x - y) for x in (solved(joint.total), expected)]
    assert left[0] == pytest.approx(left[1], rel=1e-9)


@pytest.mark.parametrize("size", [1e3, 1e10, np.nan])
def test_a_huge_row_hides_no_others_and_what_is_no_number_shows(size: float) -> None:
    rng = np.random.default_rng(5)
    H = rng.normal(size=(ROWS * BLOCKS, WIDTH))
    H[5 * ROWS + 17] *= size
    y = H @ np.ones(WIDTH) + 1e-3 * rng.normal(size=len(H))
    joint = accumulated(H, y, ROWS)
    if np.isnan(size):
        assert np.isnan(joint.blocks[5]).any()
        return
    found, expected = solved(joint.total), np.linalg.lstsq(H, y, rcond=None)[0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15 * size + 1e-12)
