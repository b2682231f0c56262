"""Clocks of IMUs that begin late, otherwise in each log, and gain on the encoders'."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.imu_calibration import clock_statements
from seqid_cli.params.schema import ImuCalibration
from tests.plants import instruments as plants
from tests.plants.instruments import FINE, instruments, offsets, scene_of, scored

DRIFTING = replace(
    FINE, label="a clock that drifts", delay=0.08, rate=3.3e-3, scatter=0.03
)


@pytest.fixture(scope="module")
def calibration() -> ImuCalibration:
    return plants.calibrated(scene_of(DRIFTING), 0).imus["imu_a"]


@pytest.mark.slow
def test_offset_and_rate_are_found_in_every_log(calibration: ImuCalibration) -> None:
    true = offsets(scene_of(DRIFTING), 0)
    assert len(calibration.clocks) == len(true)
    for clock, late in zip(calibration.clocks, true.tolist(), strict=True):
        assert abs(clock.time_offset_s - late) < 4.0 * clock.time_offset_std_error_s
        assert abs(clock.time_rate - DRIFTING.rate) < 4.0 * clock.time_rate_std_error
        assert clock.time_offset_std_error_s < 0.001
        assert clock.time_rate_std_error < 2e-4


def test_another_log_may_begin_as_unlike_as_these(calibration: ImuCalibration) -> None:
    """Its offset is as uncertain as it scatters, its rate as well known as it is."""
    scatter = float(np.std(offsets(scene_of(DRIFTING), 0)))
    assert scatter < calibration.time_offset_std_error_s < 3.0 * scatter
    off = calibration.time_rate - DRIFTING.rate
    assert abs(off) < 4.0 * calibration.time_rate_std_error < 8e-4


def test_the_mounting_does_not_suffer(calibration: ImuCalibration) -> None:
    (instrument,) = instruments(scene_of(DRIFTING), 0)
    score = scored(instrument, calibration)
    assert np.abs(score.z_turn).max() < 4.0
    assert score.turn_deg < 0.5
    assert (score.holdout or 9.0) < 1.2


def test_a_drift_is_said_with_its_number(calibration: ImuCalibration) -> None:
    text = " ".join(clock_statements(calibration))
    assert "drift apart by 3.3 +- " in text
    assert "another in each log" in text


def test_clocks_that_agree_are_not_worth_a_word() -> None:
    quiet = ImuCalibration(
        rotation=np.eye(3).tolist(),
        std_error_deg=0.1,
        time_rate=5e-5,
        time_rate_std_error=1e-6,
    )
    assert clock_statements(quiet) == []
