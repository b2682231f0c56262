"""Bands: left-out residuals against fits anew, factors against known errors,
variances.
"""

import numpy as np
import pytest
from msgspec.structs import replace as replaced

from seqid_cli.identify.bands.calibrate import joint_band
from seqid_cli.identify.bands.coverage import CoverageCounter, clearly_below
from seqid_cli.identify.bands.left_out import Fit, left_out_residuals
from seqid_cli.identify.bands.prediction import Bands
from seqid_cli.identify.bands.rows import MOST_ROWS, BandRows, BandRowsCollector
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.params.results.prediction import BandCoverage
from tests import Array
from tests.plants.robots.made import made_motion
from tests.unit.identify.rigid.test_simultaneous import identified, record, robot

SIGMA = np.array([0.5, 2.0])
LEVELS = (0.9, 0.95)


def rows_of(rng: np.random.Generator, logs: int, per_log: int) -> BandRows:
    count, theta = logs * per_log, np.array([1.0, -2.0, 0.5])
    H = rng.normal(size=(count, 2, 3))
    noise = SIGMA * rng.normal(size=(count, 2))
    still = np.zeros((count, 2))
    return BandRows(
        H=H,
        y=H @ theta + noise,
        used=rng.random((count, 2)) < 0.8,
        judged=np.ones((count, 2), dtype=bool),
        q=still,
        dq=still,
        ddq=still,
        weight=np.ones(count),
        t=np.tile(np.arange(per_log) * 0.1, logs),
        log=np.repeat(np.arange(logs), per_log),
    )


def fitted(rows: BandRows) -> Fit:
    weight = np.where(rows.used, 1.0 / SIGMA, 0.0)
    X = (rows.H * weight[..., None]).reshape(-1, 3)
    bread: Array = np.asarray(np.linalg.inv(X.T @ X), dtype=np.float64)
    return Fit(
        theta=bread @ (X.T @ (weight * rows.y).ravel()), bread=bread, sigma=SIGMA
    )


@pytest.mark.parametrize(("logs", "kind"), [(4, "logs"), (1, "stretches")])
def test_left_out_residuals_are_those_of_a_fit_anew(logs: int, kind: str) -> None:
    rows = rows_of(np.random.default_rng(1), logs, 40)
    found = left_out_residuals(rows, fitted(rows))
    assert found.kind == kind
    for fold in np.unique(found.fold):
        anew = fitted(rows.part(found.fold != fold))
        own = rows.part(found.fold == fold)
        np.testing.assert_allclose(
            found.residual[found.fold == fold], own.y - own.H @ anew.theta
        )


def test_a_log_that_alone_shows_a_parameter_is_not_left_out_whole() -> None:
    rows = rows_of(np.random.default_rng(2), 4, 40)
    rows.H[rows.log > 0, :, 2] = 0.0
    assert left_out_residuals(rows, fitted(rows)).kind == "stretches"


def drawn_errors(kind: str, rng: np.random.Generator, count: int) -> Array:
    heavy = rng.standard_t(4, count)
    return {
        "normal": rng.normal(size=count),
        "heavy": heavy,
        "flat": rng.uniform(-1, 1, count),
    }[kind]


@pytest.mark.parametrize(
    ("kind", "off"), [("normal", 0.015), ("heavy", 0.025), ("flat", 0.035)]
)
def test_both_bands_hold_whatever_the_errors(kind: str, off: float) -> None:
    rng, count = np.random.default_rng(3), 4000
    variance = rng.uniform(0.0, 1.0, count)
    error = 0.3 * np.sqrt(variance + 1.0) * drawn_errors(kind, rng, count)
    group = np.arange(count) * 5 // count
    band = joint_band(
        residual=error[::2],
        variance=0.09 * variance[::2],
        speed=rng.random(count // 2),
        load=rng.random(count // 2),
        group=group[::2],
        block=group[::2],
    )
    std = band.cells[0].factor * np.sqrt(0.09 * variance + band.left_std**2)
    for level, half_width in zip(LEVELS, (1.645, 1.96), strict=True):
        held = float(np.mean(np.abs(error[1::2]) <= half_width * std[1::2]))
        assert held == pytest.approx(level, abs=off)


@pytest.mark.parametrize("depends", [True, False])
def test_cells_count_only_where_errors_depend_on_speed(depends: bool) -> None:
    rng, count = np.random.default_rng(4), 3000
    speed = rng.random(count)
    size = np.where(depends & (speed > 0.5), 3.0, 1.0)
    group = np.arange(count) * 6 // count
    band = joint_band(
        residual=size * rng.normal(size=count),
        variance=np.zeros(count),
        speed=speed,
        load=rng.random(count),
        group=group,
        block=group,
    )
    slow, fast = band.cells[0].factor, band.cells[2].factor
    assert (fast > 1.4 * slow) if depends else (fast == slow)


def test_rows_are_thinned_to_a_bounded_number() -> None:
    still = np.zeros((20_000, 2))
    motion = made_motion(still, still, still, Lowpass(50.0, 1000.0))
    collected = BandRowsCollector()
    for _ in range(3):
        collected.next_log()
        used = np.ones((20_000, 2), dtype=bool)
        chosen = collected.pick(motion, used)
        shape = (len(chosen), 2, 1)
        masks = {"used": used[chosen], "judged": used[chosen]}
        collected.add(motion, chosen, H=np.ones(shape), y=np.ones(shape[:2]), **masks)
    together = collected + collected
    rows = together.joined()
    assert rows is not None
    assert rows.samples <= MOST_ROWS
    # Rows that were dropped are not held by those that stay.
    assert all(part.H.base is None for part in together.parts)
    assert sorted(set(rows.log.tolist())) == [0, 1, 2, 3, 4, 5]
    # Each row stands for those that it was thinned from.
    assert rows.weight.sum() == pytest.approx(6 * 20_000, rel=0.01)


def test_coverage_counts_samples_that_slide_by_cell() -> None:
    counter = CoverageCounter()
    residual = np.array([[0.5], [1.8], [2.5], [0.1], [9.0]])
    fast = np.array([[False], [False], [True], [True], [True]])
    counter.add(
        log="log",
        t=np.array([0.0, 1.0, 2.5, 2.6, 2.7]),
        residual=residual,
        std=np.ones((5, 1)),
        counts=np.array([[True], [True], [True], [True], [False]]),
        fast=fast,
        loaded=None,
    )
    found = counter.of_joint(0)
    assert found is not None
    assert found.overall == BandCoverage(band_90=0.5, band_95=0.75, samples=4, blocks=2)
    assert found.slow == BandCoverage(band_90=0.5, band_95=1.0, samples=2, blocks=1)
    assert found.fast == BandCoverage(band_90=0.5, band_95=0.5, samples=2, blocks=1)
    assert found.low_load is None


def test_coverage_counts_a_block_once_however_a_log_is_parted() -> None:
    counter = CoverageCounter()
    for log, times in (("one", [0.5, 1.5]), ("one", [1.8, 2.5]), ("two", [0.5, 1.5])):
        counter.add(
            log=log,
            t=np.array(times),
            residual=np.zeros((2, 1)),
            std=np.ones((2, 1)),
            counts=np.ones((2, 1), dtype=bool),
            fast=None,
            loaded=None,
        )
    found = counter.of_joint(0)
    assert found is not None
    assert found.overall.blocks == 3


@pytest.mark.parametrize(
    ("share", "blocks", "below"),
    [(0.6, 30, True), (0.6, 2, False), (0.85, 1000, False)],
)
def test_a_band_fails_only_clearly(share: float, blocks: int, below: bool) -> None:
    coverage = BandCoverage(band_90=share, band_95=share, samples=100, blocks=blocks)
    assert clearly_below(coverage, least_share=0.8) is below


@pytest.mark.slow
def test_bands_of_one_least_squares_hold_on_another_log() -> None:
    stages = identified(record(0, 20.0), record(1, 20.0))
    (found,) = predict([record(7, 20.0)], robot(), stages, options=InertiaOptions())
    error, counts = np.abs(found.residual), found.sliding
    for level, half_width in zip(LEVELS, (1.645, 1.96), strict=True):
        held = (counts & (error <= half_width * found.std)).sum(axis=0) / counts.sum(
            axis=0
        )
        assert np.mean(held) == pytest.approx(level, abs=0.025)
        assert held.min() > level - 0.08


def test_a_file_without_calibration_says_so() -> None:
    arm = robot()
    stages = identified(record(0, 12.0), arm=arm)
    assert stages.inertia is not None
    assert Bands.from_stages(stages, arm).notes([1.0]) == []
    (wide,) = Bands.from_stages(stages, arm).notes([1000.0])
    assert "widened for 1e+03 Hz" in wide

    stages.inertia = replaced(stages.inertia, bands=None)
    bands = Bands.from_stages(stages, arm)
    (note,) = bands.notes([1000.0])
    assert note.startswith("bands are not calibrated")
    still = np.zeros((100, arm.n))
    deviation = bands.of(made_motion(still, still, still, Lowpass(5.0, 100.0)))
    assert deviation.fast is None
    rmse = [stages.inertia.rmse[name] for name in arm.joint_names]
    assert np.all(deviation.std >= rmse)
