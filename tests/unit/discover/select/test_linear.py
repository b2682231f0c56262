"""The linear model against densities written out in full."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from seqid_cli.discover.select import arrow
from seqid_cli.discover.select import linear as linear_module
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import PriorUpdate
from seqid_cli.discover.select.rows import (
    ColumnGroup,
    LogColumns,
    Observations,
    Recurring,
)
from seqid_cli.tiles import tiles
from seqid_cli.typing import Index
from tests import Array


@pytest.fixture(autouse=True, params=[2, 24], ids=["own roots", "one root"])
def fewest(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups so small have roots of their own, or none has."""
    monkeypatch.setattr(arrow, "FEWEST", request.param)


BLOCKS = 4
LENGTHS = (24, 17)  # rows of two channels


def columns(seed: int, size: int, channels: int = 2) -> dict[int, Array]:
    rng = np.random.default_rng(seed)
    return {c: rng.standard_normal((m, size)) for c, m in enumerate(LENGTHS[:channels])}


def drawn_rows() -> Observations:
    """Two channels in four blocks of time."""
    rng = np.random.default_rng(1)
    block = tuple(np.sort(rng.integers(0, BLOCKS, m)).astype(np.intp) for m in LENGTHS)
    return Observations(tuple(rng.standard_normal(m) for m in LENGTHS), block, BLOCKS)


ROWS = drawn_rows()
# The second block has no rows in the first channel.
SPARSE = replace(
    ROWS, block=(np.where(ROWS.block[0] == 1, 2, ROWS.block[0]), ROWS.block[1])
)
WEIGHT = [
    np.random.default_rng(4 + c).uniform(0.5, 2.0, m) for c, m in enumerate(LENGTHS)
]
# Three parameters that both channels share, and two of the first channel's own.
BASE = [
    ColumnGroup(columns=columns(2, 3), precision=np.diag([1.0, 2.0, 0.5])),
    ColumnGroup(columns=columns(5, 2, channels=1), precision=np.diag([0.3, 4.0])),
]
TERM = ColumnGroup(columns=columns(3, 2), precision=np.diag([0.7, 1.5]))


# The first block and the last, of another log, are of one motion.
PART_OF_BLOCK = np.array([0, 1, 2, 0])


def linear(parts: list[ColumnGroup]) -> LinearModel:
    return LinearModel(ROWS, parts, WEIGHT)


def log_density(parts: list[ColumnGroup], without: int | None = None) -> float:
    """Log density of the rows of all blocks but one, all parameters integrated out."""
    covariance = np.diag(1.0 / np.concatenate(WEIGHT))
    for part in parts:
        zeros = {c: np.zeros((m, part.size)) for c, m in enumerate(LENGTHS)}
        X = np.vstack([*(zeros | part.columns).values()])
        covariance += X @ np.linalg.inv(part.precision) @ X.T
    at = np.flatnonzero(np.concatenate(ROWS.block) != without)
    y = np.concatenate(ROWS.y)[at]
    return float(multivariate_normal.logpdf(y, cov=covariance[np.ix_(at, at)]))


IN_FILE = {
    0: np.array([[0.7, -2.0], [0.0, 1.5], [3.0, 0.4]]),
    1: np.array([[1.1, 0.0]]),
}


def _less_in_file(base: list[ColumnGroup], part: ColumnGroup) -> ColumnGroup:
    """The part with what the file has of it taken off its columns instead."""
    columns = dict(part.columns)
    for number, R in part.absorbed_by_file.items():
        for c, B in base[number].columns.items():
            columns[c] = columns.get(c, 0.0) - B[:, : len(R)] @ R
    return replace(part, columns=columns, absorbed_by_file={})


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside another"])
def test_what_a_file_has_of_a_term_is_as_if_taken_off_its_columns(beside: bool) -> None:
    base = [replace(part, precision_without_file=0.4 * part.precision) for part in BASE]
    other = ColumnGroup(
        columns={0: np.ones((LENGTHS[0], 1))},
        precision=np.eye(1),
        absorbed_by_file={0: np.ones((3, 1))},
    )
    absorbed, model = (
        replace(TERM, absorbed_by_file=IN_FILE),
        [*base, *[other] * beside],
    )
    less, same = (
        _less_in_file(base, absorbed),
        [_less_in_file(base, part) for part in model],
    )

    tried, expected = linear(model), linear(same)
    one, two = tried.fits([TERM, absorbed])[1], expected.fits([less])[0]
    assert one.log_bayes_factor == pytest.approx(two.log_bayes_factor, abs=1e-6)
    np.testing.assert_allclose(one.coefficients, two.coefficients, atol=1e-7)
    np.testing.assert_allclose(one.covariance, two.covariance, atol=1e-7)
    left_out, as_well = (
        tried.scores([TERM, absorbed])[1],
        expected.scores([less])[0],
    )
    np.testing.assert_allclose(left_out.part_gains, as_well.part_gains, atol=1e-6)
    assert left_out.file_gain == pytest.approx(as_well.file_gain, abs=1e-6)

    taken, expected = linear([*model, absorbed]), linear([*same, less])
    assert taken.evidence == pytest.approx(expected.evidence, abs=1e-6)
    np.testing.assert_allclose(taken.held, expected.theta, atol=1e-6)
    for r, s in zip(taken.left_out, expected.left_out, strict=True):
        np.testing.assert_allclose(r, s, atol=1e-6)
    torque = less.columns[1] @ expected.theta[-TERM.size :]
    np.testing.assert_allclose(taken.torque_beside_file(absorbed, 1), torque, atol=1e-6)
    loosened, as_expected = (
        PriorUpdate(model).covariance for model in (taken, expected)
    )
    np.testing.assert_allclose(loosened, as_expected, atol=1e-6)


def test_terms_of_two_channels_meet_in_what_the_file_has_of_both() -> None:
    in_file = {0: IN_FILE[0]}
    terms = [
        ColumnGroup(
            columns={channel: columns(3, 2)[channel]},
            precision=TERM.precision,
            absorbed_by_file=in_file,
        )
        for channel in (0, 1)
    ]
    taken = linear([*BASE, *terms])
    expected = linear([*BASE, *(_less_in_file(BASE, term) for term in terms)])
    assert taken.evidence == pytest.approx(expected.evidence, abs=1e-6)
    np.testing.assert_allclose(taken.held, expected.theta, atol=1e-6)


def test_evidence_is_the_ratio_of_two_densities() -> None:
    expected = log_density([*BASE, TERM]) - log_density(BASE)
    without, with_it = linear(BASE), linear([*BASE, TERM])
    gained = without.fits([TERM])[0]
    assert gained.log_bayes_factor == pytest.approx(expected, abs=1e-6)
    assert with_it.evidence - without.evidence == pytest.approx(expected, abs=1e-6)
    at = with_it.where[-1]
    np.testing.assert_allclose(gained.coefficients, with_it.theta[at], rtol=1e-6)
    np.testing.assert_allclose(gained.covariance, with_it.covariance[at, at], rtol=1e-6)


@pytest.mark.parametrize("rows", [ROWS, SPARSE], ids=["all", "a block in one channel"])
def test_the_jackknife_is_the_spread_of_fits_without_a_block(
    rows: Observations,
) -> None:
    parts = [*BASE, TERM]
    X = np.vstack(
        [
            np.hstack([part.columns.get(c, np.zeros((m, part.size))) for part in parts])
            for c, m in enumerate(LENGTHS)
        ]
    )
    block = np.concatenate(rows.block)
    y = np.concatenate(rows.y)
    weight = np.concatenate(WEIGHT)
    model = LinearModel(rows, parts, WEIGHT)
    without = []
    for left_out in range(BLOCKS):
        w = weight * (block != left_out)
        A = model.prior + X.T @ (w[:, None] * X)
        without.append(np.linalg.solve(A, X.T @ (w * y)))
    expected = (BLOCKS - 1) * np.cov(np.transpose(without), bias=True)
    np.testing.assert_allclose(
        model.jackknife(slice(0, model.size)), expected, rtol=1e-6, atol=1e-12
    )


def test_gain_of_a_block_is_that_of_its_density_given_all_others() -> None:
    told = linear(BASE).scores([TERM])[0]
    for b in range(BLOCKS):
        without, with_it = (
            log_density(parts) - log_density(parts, without=b)
            for parts in (BASE, [*BASE, TERM])
        )
        assert told.part_gains[b] == pytest.approx(with_it - without, abs=1e-6)


def test_blocks_of_one_motion_are_left_out_together() -> None:
    """As one block that has the rows of both, wherever they stand."""
    together = replace(ROWS, part_of_block=PART_OF_BLOCK)
    joined = [
        np.where(block == BLOCKS - 1, 0, block) for block in ROWS.block
    ]  # the last block is part of the first
    order = [np.argsort(block, kind="stable") for block in joined]
    as_one = replace(
        ROWS,
        y=tuple(y[at] for y, at in zip(ROWS.y, order, strict=True)),
        block=tuple(block[at] for block, at in zip(joined, order, strict=True)),
        blocks=BLOCKS - 1,
    )

    def sorted_rows(part: ColumnGroup) -> ColumnGroup:
        return replace(part, columns={c: X[order[c]] for c, X in part.columns.items()})

    model = LinearModel(together, [*BASE, TERM], WEIGHT)
    weight = [w[at] for w, at in zip(WEIGHT, order, strict=True)]
    parts = [sorted_rows(part) for part in (*BASE, TERM)]
    expected = LinearModel(as_one, parts, weight)
    for left, of_joined, at in zip(
        model.left_out, expected.left_out, order, strict=True
    ):
        np.testing.assert_allclose(left[at], of_joined, rtol=1e-9)
    np.testing.assert_allclose(
        model.again(TERM)[1].part_gains, expected.again(parts[-1])[1].part_gains
    )
    other = ColumnGroup(columns=columns(9, 3), precision=np.diag([0.4, 1.0, 2.0]))
    score = model.scores([other])[0]
    as_joined = expected.scores([sorted_rows(other)])[0]
    np.testing.assert_allclose(score.part_gains, as_joined.part_gains)
    np.testing.assert_allclose(score.rows, as_joined.rows)


def recurring_noise() -> tuple[list[Recurring], list[Array]]:
    """Noise that three moments of each channel share, and its covariance in full.

    A moment has rows of one part alone, and those of the last are there once.
    """
    noise = []
    covariance = []
    for channel, block in enumerate(ROWS.block):
        part = PART_OF_BLOCK[block]
        moment = np.where(part == 0, 0, 1)
        moment[np.flatnonzero(part == 2)] = 2
        times = np.array([1.0, 2.5, 0.0])
        variance = 0.8 + 0.4 * channel
        noise.append(Recurring.of(WEIGHT[channel], moment, variance, times))
        shared = variance * times[moment] * (moment[:, None] == moment)
        covariance.append(np.diag(1.0 / WEIGHT[channel]) + shared)
    return noise, covariance


def test_noise_that_comes_again_is_as_if_its_covariance_were_written_out() -> None:
    """Rows times a root of their precision have unit noise, each by itself."""
    noise, covariance = recurring_noise()
    rows = replace(ROWS, part_of_block=PART_OF_BLOCK)
    other = ColumnGroup(columns=columns(9, 3), precision=np.diag([0.4, 1.0, 2.0]))
    parts = [*BASE, TERM]
    model = LinearModel(rows, parts, WEIGHT, recurring=noise)

    roots = [np.linalg.cholesky(np.linalg.inv(C)).T for C in covariance]

    def scaled(part: ColumnGroup) -> ColumnGroup:
        return replace(part, columns={c: roots[c] @ X for c, X in part.columns.items()})

    y = tuple(root @ of_channel for root, of_channel in zip(roots, ROWS.y, strict=True))
    unit = [np.ones(m) for m in LENGTHS]
    expected = LinearModel(replace(rows, y=y), [*map(scaled, parts)], unit)
    np.testing.assert_allclose(model.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(model.covariance, expected.covariance, rtol=1e-9)
    gained = model.evidence - model.without(TERM).evidence
    written_out = expected.evidence - expected.without(expected.parts[-1]).evidence
    assert gained == pytest.approx(written_out, rel=1e-9)
    np.testing.assert_allclose(
        model.jackknife(slice(0, model.size)),
        expected.jackknife(slice(0, model.size)),
        rtol=1e-7,
    )
    for fit, as_written in (
        (model.fits([other])[0], expected.fits([scaled(other)])[0]),
        (model.again(TERM)[0], expected.again(expected.parts[-1])[0]),
    ):
        np.testing.assert_allclose(fit.coefficients, as_written.coefficients)
        np.testing.assert_allclose(fit.covariance, as_written.covariance)
    np.testing.assert_allclose(
        model.scores([other])[0].part_gains,
        expected.scores([scaled(other)])[0].part_gains,
        rtol=1e-7,
    )


def test_gain_of_the_file_is_what_the_term_gains_less_without_it() -> None:
    alone = [
        ColumnGroup(columns=part.columns, precision=0.1 * part.precision)
        for part in BASE
    ]
    held = [
        ColumnGroup(
            columns=a.columns, precision=b.precision, precision_without_file=a.precision
        )
        for a, b in zip(alone, BASE, strict=True)
    ]
    with_file, without = (
        log_density([*parts, TERM]) - log_density(parts) for parts in (BASE, alone)
    )
    told = linear(held).scores([TERM])[0]
    assert told.file_gain == pytest.approx(with_file - without, abs=1e-6)
    assert told.total == pytest.approx(told.part_gains.sum() + told.file_gain)


def test_a_part_of_the_model_gains_what_it_did_before_it_was_taken() -> None:
    whole = linear([BASE[0], TERM, BASE[1]])
    before = whole.without(TERM)
    np.testing.assert_allclose(before.theta, linear(BASE).theta, rtol=1e-9)
    (gained,), (told,) = before.fits([TERM]), before.scores([TERM])
    again, told_again = whole.again(TERM)
    np.testing.assert_allclose(told_again.part_gains, told.part_gains, atol=1e-6)
    assert told_again.total == pytest.approx(told.total, abs=1e-6)
    assert again.log_bayes_factor == pytest.approx(gained.log_bayes_factor, abs=1e-6)
    assert again.visible_share == pytest.approx(gained.visible_share, rel=1e-6)
    np.testing.assert_allclose(again.coefficients, gained.coefficients, rtol=1e-6)
    np.testing.assert_allclose(again.covariance, gained.covariance, rtol=1e-6)


def test_another_size_in_every_block_is_worth_what_its_columns_are() -> None:
    """By densities written out: a column of each block, of 0.3 beforehand."""
    parts = [*BASE, TERM]
    model = linear(parts)
    sizes = {}
    for channel, block in enumerate(ROWS.block):
        torque = TERM.columns[channel] @ model.theta[model.where[-1]]
        sizes[channel] = torque[:, None] * (block[:, None] == np.arange(BLOCKS))
    varied = ColumnGroup(columns=sizes, precision=np.eye(BLOCKS) / 0.3**2)
    expected = log_density([*parts, varied]) - log_density(parts)
    assert model.varied(TERM) == pytest.approx(expected, abs=1e-6)


LOG_OF_BLOCK = np.array([0, 0, 1, 1])
OWN_SIZE = 2


def models_of_two_logs(
    channels: tuple[int, ...] = (0, 1), part_of_block: Index | None = None
) -> tuple[LinearModel, LinearModel]:
    """Return one model twice: logs have columns of their own, or as any others.

    They have them in some channels.
    """
    rows = replace(ROWS, log_of_block=LOG_OF_BLOCK, part_of_block=part_of_block)
    precision = np.diag([0.6, 2.5])
    of_logs = []
    as_others = []
    for channel in channels:
        length = LENGTHS[channel]
        own = np.random.default_rng(7 + channel).standard_normal((length, OWN_SIZE))
        of_logs.append(LogColumns(channel=channel, columns=own, precision=precision))
        log = LOG_OF_BLOCK[rows.block[channel]]
        for number in (0, 1):
            columns = {channel: own * (log == number)[:, None]}
            as_others.append(ColumnGroup(columns=columns, precision=precision))
    parts = [*BASE, TERM]
    return (
        LinearModel(rows, parts, WEIGHT, of_logs),
        LinearModel(rows, [*parts, *as_others], WEIGHT),
    )


@pytest.mark.parametrize("part_of_block", [None, PART_OF_BLOCK], ids=["once", "again"])
@pytest.mark.parametrize("channels", [(0, 1), (0,), (1,)])
def test_what_each_log_has_for_itself_costs_no_parameters(
    channels: tuple[int, ...], part_of_block: Index | None
) -> None:
    """Eliminated, it changes neither what is left out nor what a term is worth."""
    model, written_out = models_of_two_logs(channels, part_of_block)
    size = sum(part.size for part in (*BASE, TERM))
    assert model.size == size < written_out.size

    other = ColumnGroup(columns=columns(9, 3), precision=np.diag([0.4, 1.0, 2.0]))
    last = ColumnGroup(columns={1: columns(8, 2)[1]}, precision=np.diag([0.9, 0.2]))
    for of_model in (
        lambda x: x.theta[:size],
        lambda x: x.covariance[:size, :size],
        lambda x: x.jackknife(slice(0, size)),
        lambda x: np.concatenate(x.residual()),
        lambda x: np.concatenate(x.left_out),
        lambda x: np.concatenate(x.without(TERM).left_out),
        lambda x: x.evidence,
        lambda x: x.evidence - x.without(TERM).evidence,
        lambda x: x.varied(TERM),
        lambda x: x.fits([other, TERM])[0].log_bayes_factor,
        lambda x: x.fits([other])[0].covariance,
        lambda x: x.fits([last])[0].log_bayes_factor,
        lambda x: x.scores([last])[0].part_gains,
        lambda x: x.scores([other])[0].part_gains,
        lambda x: x.scores([other])[0].file_gain,
        lambda x: x.again(TERM)[1].part_gains,
    ):
        np.testing.assert_allclose(
            of_model(model), of_model(written_out), rtol=1e-7, atol=1e-9
        )


@pytest.mark.parametrize("channels", [(), (0, 1)], ids=["shared", "own columns"])
def test_a_long_log_is_added_up_in_parts(
    monkeypatch: pytest.MonkeyPatch, channels: tuple[int, ...]
) -> None:
    model, _ = models_of_two_logs(channels)
    other = ColumnGroup(columns=columns(9, 3), precision=np.diag([0.4, 1.0, 2.0]))
    fit = model.fits([other])[0]
    score = model.scores([other])[0]
    monkeypatch.setattr(linear_module, "tiles", partial(tiles, size=5))
    in_parts = model.fits([other])[0]
    np.testing.assert_allclose(in_parts.coefficients, fit.coefficients, rtol=1e-9)
    np.testing.assert_allclose(in_parts.covariance, fit.covariance, rtol=1e-9)
    gains = model.scores([other])[0].part_gains
    np.testing.assert_allclose(gains, score.part_gains, rtol=1e-9)


def test_a_whole_log_is_predicted_by_the_others() -> None:
    model, _ = models_of_two_logs()
    left = model.left_out_of(np.arange(2))
    for log in (0, 1):
        of_log = [LOG_OF_BLOCK[block] == log for block in ROWS.block]
        A, b = model.prior.copy(), np.zeros(model.size)
        for channel in (0, 1):
            X = np.hstack(
                [
                    part.columns[channel]
                    if channel in part.columns
                    else np.zeros((LENGTHS[channel], part.size))
                    for part in model.parts
                ]
            )
            own = model.of_logs[channel]
            others = ~of_log[channel]
            noise = np.diag(1.0 / WEIGHT[channel][others])
            S = own.columns[others]
            noise += S @ np.linalg.inv(own.precision) @ S.T
            A += X[others].T @ np.linalg.solve(noise, X[others])
            b += X[others].T @ np.linalg.solve(noise, ROWS.y[channel][others])
        theta = np.linalg.solve(A, b)
        for channel in (0, 1):
            X = np.hstack(
                [
                    part.columns[channel]
                    if channel in part.columns
                    else np.zeros((LENGTHS[channel], part.size))
                    for part in model.parts
                ]
            )
            expected = (ROWS.y[channel] - X @ theta)[of_log[channel]]
            np.testing.assert_allclose(
                left[channel][of_log[channel]], expected, rtol=1e-6
            )
