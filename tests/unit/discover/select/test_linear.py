"""The linear model against densities written out in full."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from seqid_cli.discover.select.linear import Linear
from seqid_cli.discover.select.model import Loosened
from seqid_cli.discover.select.rows import Part, Rows
from tests import Array

BLOCKS = 4
LENGTHS = (24, 17)  # rows of two channels


@pytest.fixture
def rows() -> Rows:
    """Two channels in four blocks of time."""
    rng = np.random.default_rng(1)
    block = tuple(np.sort(rng.integers(0, BLOCKS, m)).astype(np.intp) for m in LENGTHS)
    return Rows(tuple(rng.standard_normal(m) for m in LENGTHS), block, BLOCKS)


@pytest.fixture
def base() -> list[Part]:
    """Three parameters that both channels share, and two of the first channel's own."""
    rng = np.random.default_rng(2)
    shared = {c: rng.standard_normal((m, 3)) for c, m in enumerate(LENGTHS)}
    own = {0: rng.standard_normal((LENGTHS[0], 2))}
    return [Part(shared, np.diag([1.0, 2.0, 0.5])), Part(own, np.diag([0.3, 4.0]))]


@pytest.fixture
def term() -> Part:
    """Two columns at both channels."""
    rng = np.random.default_rng(3)
    columns = {c: rng.standard_normal((m, 2)) for c, m in enumerate(LENGTHS)}
    return Part(columns, np.diag([0.7, 1.5]))


@pytest.fixture
def weight() -> list[Array]:
    """Precision of every row."""
    rng = np.random.default_rng(4)
    return [rng.uniform(0.5, 2.0, m) for m in LENGTHS]


def log_density(rows: Rows, parts: list[Part], weight: list[Array], kept: Array) -> float:
    """Log density of the kept rows with all parameters integrated out."""
    y = np.concatenate(rows.y)
    covariance = np.diag(1.0 / np.concatenate(weight))
    for part in parts:
        X = np.vstack(
            [part.columns.get(c, np.zeros((m, part.size))) for c, m in enumerate(LENGTHS)]
        )
        covariance += X @ np.linalg.inv(part.precision) @ X.T
    at = np.flatnonzero(kept)
    return float(multivariate_normal.logpdf(y[at], cov=covariance[np.ix_(at, at)]))


IN_FILE = {0: np.array([[0.7, -2.0], [0.0, 1.5], [3.0, 0.4]]), 1: np.array([[1.1, 0.0]])}


def _less_in_file(base: list[Part], part: Part) -> Part:
    """The part with what the file has of it taken off its columns instead."""
    columns = dict(part.columns)
    for number, R in part.in_file.items():
        for c, B in base[number].columns.items():
            columns[c] = columns.get(c, 0.0) - B[:, : len(R)] @ R
    return replace(part, columns=columns, in_file={})


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside another"])
def test_what_a_file_has_of_a_term_is_as_if_taken_off_its_columns(
    rows: Rows, base: list[Part], term: Part, weight: list[Array], beside: bool
) -> None:
    base = [replace(part, apart=0.4 * part.precision) for part in base]
    other = Part({0: np.ones((LENGTHS[0], 1))}, np.eye(1), in_file={0: np.ones((3, 1))})
    absorbed, model = replace(term, in_file=IN_FILE), [*base, *[other] * beside]
    less, same = _less_in_file(base, absorbed), [_less_in_file(base, part) for part in model]

    tried, expected = Linear(rows, model, weight), Linear(rows, same, weight)
    one, two = tried.gained([term, absorbed])[1], expected.gained([less])[0]
    assert one.evidence == pytest.approx(two.evidence, abs=1e-6)
    np.testing.assert_allclose(one.coefficients, two.coefficients, atol=1e-7)
    np.testing.assert_allclose(one.covariance, two.covariance, atol=1e-7)
    left_out, as_well = tried.predicted([term, absorbed])[1], expected.predicted([less])[0]
    np.testing.assert_allclose(left_out.density, as_well.density, atol=1e-6)
    assert left_out.file == pytest.approx(as_well.file, abs=1e-6)

    taken, expected = (Linear(rows, parts, weight) for parts in ([*model, absorbed], [*same, less]))
    assert taken.evidence == pytest.approx(expected.evidence, abs=1e-6)
    np.testing.assert_allclose(taken.held, expected.theta, atol=1e-6)
    for r, s in zip(taken.left_out, expected.left_out, strict=True):
        np.testing.assert_allclose(r, s, atol=1e-6)
    torque = less.columns[1] @ expected.theta[-term.size :]
    np.testing.assert_allclose(taken.torque_beside_file(absorbed, 1), torque, atol=1e-6)
    loosened, expected_too = Loosened(taken), Loosened(expected)
    np.testing.assert_allclose(loosened.covariance, expected_too.covariance, atol=1e-6)


def test_evidence_is_the_ratio_of_two_densities(
    rows: Rows, base: list[Part], term: Part, weight: list[Array]
) -> None:
    every = np.ones(sum(LENGTHS), dtype=bool)
    without, with_it = (log_density(rows, parts, weight, every) for parts in (base, [*base, term]))
    gained = Linear(rows, base, weight).gained([term])[0]
    assert gained.evidence == pytest.approx(with_it - without, abs=1e-6)
    models = [Linear(rows, parts, weight).evidence for parts in (base, [*base, term])]
    assert models[1] - models[0] == pytest.approx(with_it - without, abs=1e-6)


def test_gain_of_a_block_is_that_of_its_density_given_all_others(
    rows: Rows, base: list[Part], term: Part, weight: list[Array]
) -> None:
    block = np.concatenate(rows.block)
    every = np.ones(sum(LENGTHS), dtype=bool)
    told = Linear(rows, base, weight).predicted([term])[0]
    for b in range(BLOCKS):
        given = [
            log_density(rows, parts, weight, every) - log_density(rows, parts, weight, block != b)
            for parts in (base, [*base, term])
        ]
        assert told.density[b] == pytest.approx(given[1] - given[0], abs=1e-6)


def test_gain_of_the_file_is_what_the_term_gains_less_without_it(
    rows: Rows, base: list[Part], term: Part, weight: list[Array]
) -> None:
    alone = [Part(part.columns, 0.1 * part.precision) for part in base]
    held = [Part(a.columns, b.precision, a.precision) for a, b in zip(alone, base, strict=True)]
    every = np.ones(sum(LENGTHS), dtype=bool)
    with_file, without = (
        log_density(rows, [*parts, term], weight, every) - log_density(rows, parts, weight, every)
        for parts in (base, alone)
    )
    told = Linear(rows, held, weight).predicted([term])[0]
    assert told.file == pytest.approx(with_file - without, abs=1e-6)
    assert told.total == pytest.approx(told.density.sum() + told.file)


def test_coefficients_and_errors_are_the_models_own(
    rows: Rows, base: list[Part], term: Part, weight: list[Array]
) -> None:
    gained = Linear(rows, base, weight).gained([term])[0]
    whole = Linear(rows, [*base, term], weight)
    at = whole.where[-1]
    np.testing.assert_allclose(gained.coefficients, whole.theta[at], rtol=1e-6)
    np.testing.assert_allclose(gained.covariance, whole.covariance[at, at], rtol=1e-6)


def test_a_part_of_the_model_gains_what_it_did_before_it_was_taken(
    rows: Rows, base: list[Part], term: Part, weight: list[Array]
) -> None:
    whole = Linear(rows, [base[0], term, base[1]], weight)
    before = whole.without(term)
    np.testing.assert_allclose(before.theta, Linear(rows, base, weight).theta, rtol=1e-9)
    (gained,), (told,) = before.gained([term]), before.predicted([term])
    again, told_again = whole.again(term)
    np.testing.assert_allclose(told_again.density, told.density, atol=1e-6)
    assert told_again.total == pytest.approx(told.total, abs=1e-6)
    assert again.evidence == pytest.approx(gained.evidence, abs=1e-6)
    assert again.visible == pytest.approx(gained.visible, rel=1e-6)
    np.testing.assert_allclose(again.coefficients, gained.coefficients, rtol=1e-6)
    np.testing.assert_allclose(again.covariance, gained.covariance, rtol=1e-6)
