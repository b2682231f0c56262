"""Normal equations against brute force: what is gained where it was not fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.system import Block, Joints, System
from seqid_cli.discover.wide import high_band
from tests.discover.arms import arm_scenes, random_columns

Array = NDArray[np.float64]

SHARED, OWN = 3, 2
NOISE = (0.4, 2.0)


@pytest.fixture(scope="module")
def rows() -> Rows:
    return rows_of(arm_scenes(logs=2, seconds=8.0))


def system_of(rows: Rows, *, high: bool = False, prior: float = 0.0) -> System:
    """Random base columns, shared and own ones, and a random residual with some of them in it."""
    rng = np.random.default_rng(3)
    band = high_band(rows) if high else None
    shared = random_columns(rows, range(rows.n), SHARED, 1)
    blocks = [Block(shared, prior * np.eye(SHARED))]
    blocks += [Block(random_columns(rows, [j], OWN, 7 + j), np.zeros((0, OWN))) for j in (0, 1)]
    lengths = [rows.count(j) for j in range(rows.n)]
    if band is not None:
        lengths += [len(y) for y in band.y]
    y = [rng.normal(size=m) for m in lengths]
    for j in range(rows.n):
        y[j] += shared[j] @ np.array([0.5, -1.0, 0.2])
    noise = [np.full(m, size) for m, size in zip(lengths, NOISE * 2, strict=False)]
    return System(rows, y, noise, blocks, band)


def stacked(system: System, columns: Joints | None) -> tuple[Array, Array, Array, Array]:
    """Everything as one least squares: X, y, fold and joint of every row, scaled."""
    X, y, fold, joint = [], [], [], []
    n = system.rows.n
    width = 0 if columns is None else next(iter(columns.values())).shape[1]
    for j in range(len(system.y)):
        rows = np.zeros((len(system.y[j]), system.size + width))
        for block, where in zip(system.blocks, system.where, strict=True):
            if j in block.columns:
                rows[:, where] = block.columns[j]
        if columns is not None and j in columns:
            rows[:, system.size :] = columns[j]
        X.append(rows / system.noise[j][:, None])
        y.append(system.y[j] / system.noise[j])
        high = system.high
        fold.append(system.rows.folds_of(j) if high is None or j < n else high.fold[j - n])
        joint.append(np.full(len(system.y[j]), j))
    return np.vstack(X), np.concatenate(y), np.concatenate(fold), np.concatenate(joint)


def solved(X: Array, y: Array, blocks: Sequence[Block]) -> Array:
    """Least squares with the blocks' priors."""
    prior = np.zeros((0, X.shape[1]))
    first = 0
    for block in blocks:
        more = np.zeros((len(block.prior), X.shape[1]))
        more[:, first : first + block.size] = block.prior
        prior = np.vstack([prior, more])
        first += block.size
    both = np.vstack([X, prior])
    return np.linalg.lstsq(both, np.concatenate([y, np.zeros(len(prior))]), rcond=None)[0]


def left_out(system: System, columns: Joints | None, held: float = 0.0) -> Array:
    """Squared residual (F, channels) of each fold, fitted to the others, by brute force."""
    X, y, fold, joint = stacked(system, columns)
    loss = np.zeros((system.folds, len(system.y)))
    blocks = list(system.blocks)
    if columns is not None:
        blocks.append(Block(columns, np.sqrt(held) * np.eye(X.shape[1] - system.size)))
    for f in range(system.folds):
        theta = solved(X[fold != f], y[fold != f], blocks)
        for j in range(len(system.y)):
            at = (fold == f) & (joint == j)
            loss[f, j] = np.sum((y[at] - X[at] @ theta) ** 2)
    return loss


CANDIDATES = [([0], 1), ([1], 1), ([0, 1], 1), ([1], 2), ([0, 1], 3)]


@pytest.mark.parametrize("prior", [0.0, 5.0])
def test_gains_are_what_leaving_folds_out_gives(rows: Rows, prior: float) -> None:
    system = system_of(rows, prior=prior)
    candidates = [random_columns(rows, joints, k, 20 + k) for joints, k in CANDIDATES]
    before = left_out(system, None)
    np.testing.assert_allclose(system.loss, before, rtol=1e-8)
    for columns, trial in zip(candidates, system.tried(candidates), strict=True):
        gain = (before - left_out(system, columns)).sum(axis=1)
        np.testing.assert_allclose(trial.gain, gain, atol=1e-8 * before.sum())
        loss = before[:, sorted(columns)].sum(axis=1)
        np.testing.assert_allclose(trial.loss, loss, rtol=1e-8)
        assert trial.relative == pytest.approx(gain.sum() / loss.sum(), abs=1e-8)


def test_coefficients_that_are_held_stay_small(rows: Rows) -> None:
    system, held = system_of(rows), [30.0, 200.0, 5.0, 80.0, 4000.0]
    candidates = [random_columns(rows, joints, k, 20 + k) for joints, k in CANDIDATES]
    before = left_out(system, None)
    trials = system.tried(candidates, held)
    for columns, own, trial in zip(candidates, held, trials, strict=True):
        gain = (before - left_out(system, columns, own)).sum(axis=1)
        np.testing.assert_allclose(trial.gain, gain, atol=1e-8 * before.sum())
    free = system.tried(candidates)[-1].coefficients
    assert np.linalg.norm(trials[-1].coefficients) < 0.7 * np.linalg.norm(free)


def test_coefficients_and_their_covariance(rows: Rows) -> None:
    system = system_of(rows)
    columns = random_columns(rows, [0, 1], 2, 5)
    (trial,) = system.tried([columns])
    X, y, _, _ = stacked(system, columns)
    theta = solved(X, y, system.blocks)
    np.testing.assert_allclose(trial.coefficients, theta[system.size :], rtol=1e-6)
    own = slice(system.size, None)
    np.testing.assert_allclose(trial.covariance, np.linalg.inv(X.T @ X)[own, own], rtol=1e-6)


def test_the_base_alone(rows: Rows) -> None:
    system = system_of(rows)
    X, y, _, joint = stacked(system, None)
    theta = solved(X, y, system.blocks)
    np.testing.assert_allclose(system.theta, theta, rtol=1e-6)
    np.testing.assert_allclose(system.covariance, np.linalg.inv(X.T @ X), rtol=1e-6, atol=1e-12)
    for j, left in enumerate(system.residual()):
        np.testing.assert_allclose(left, NOISE[j] * (y - X @ theta)[joint == j], atol=1e-7)


def test_what_the_base_can_absorb_does_not_count(rows: Rows) -> None:
    system = system_of(rows)
    shared = system.blocks[0].columns
    absorbed = {j: shared[j][:, :1] - 2 * shared[j][:, 1:2] for j in (0, 1)}
    fresh = random_columns(rows, [0], 1, 9)
    half = {0: fresh[0] + system.blocks[1].columns[0][:, :1]}
    nothing, visible, partly = system.tried([absorbed, fresh, half])
    assert nothing.visible < 1e-3
    assert nothing.total == pytest.approx(0.0, abs=1e-6)
    assert visible.visible > 0.98
    assert partly.visible == pytest.approx(np.sqrt(0.5), abs=0.05)


def test_a_column_twice_is_as_good_as_once(rows: Rows) -> None:
    system = system_of(rows)
    once = random_columns(rows, [1], 1, 31)
    twice = {1: np.hstack([once[1], once[1]])}
    one, two = system.tried([once, twice])
    assert np.all(np.isfinite(two.coefficients))
    np.testing.assert_allclose(two.gain, one.gain, atol=1e-5)
    np.testing.assert_allclose(two.coefficients.sum(), one.coefficients[0], rtol=1e-5)


def test_trying_together_or_alone_is_the_same(rows: Rows) -> None:
    system = system_of(rows)
    candidates = [random_columns(rows, joints, k, 50 + k) for joints, k in CANDIDATES]
    together = system.tried(candidates)
    for columns, trial in zip(candidates, together, strict=True):
        (alone,) = system.tried([columns])
        np.testing.assert_allclose(alone.gain, trial.gain, rtol=1e-9, atol=1e-9)
    assert system.tried([]) == []


def test_channels_above_the_cutoff(rows: Rows) -> None:
    """They count in the gain; the loss that it is compared with is that of the joint's rows."""
    system = system_of(rows, high=True)
    n = rows.n
    rng = np.random.default_rng(8)
    columns = {
        0: rng.normal(size=(rows.count(0), 2)),
        n: rng.normal(size=(len(system.y[n]), 2)) + system.y[n][:, None],
    }
    (trial,) = system.tried([columns])
    before = left_out(system, None)
    gain = (before - left_out(system, columns)).sum(axis=1)
    np.testing.assert_allclose(trial.gain, gain, atol=1e-8 * before.sum())
    np.testing.assert_allclose(trial.loss, before[:, 0], rtol=1e-8)
    assert trial.total > 0.3 * before[:, n].sum()
