"""The cut-off follows the encoder and the motion; its noise figures are those of
quantisation.
"""

import numpy as np
import pytest

from seqid_cli.motion.filters.bandwidth import (
    Cutoff,
    is_continuous,
    step_between,
    step_of,
)
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.filters.survey import Survey
from seqid_cli.typing import Array
from tests.plants.sensors import quantise

RATE = 500.0


def chosen(q: Array, rate_hz: float, resolution: Array | None = None) -> Cutoff:
    steps = np.zeros(q.shape[1]) if resolution is None else resolution
    return Survey.of(q, rate_hz).cutoff(steps)


def motion(
    rng: np.random.Generator, seconds: float = 20.0, top_hz: float = 1.5
) -> Array:
    t = np.arange(round(seconds * RATE)) / RATE
    frequency = rng.uniform(0.1, top_hz, (8, 2))
    phase = rng.uniform(0, 2 * np.pi, (8, 2))
    return np.asarray(
        0.4 * np.sin(2 * np.pi * t[:, None, None] * frequency + phase).sum(axis=1)
    )


def test_the_coarser_the_encoder_the_lower_the_cutoff() -> None:
    q = motion(np.random.default_rng(2))
    hz = [chosen(quantise(q, 2 * np.pi / 2**bits), RATE).hz for bits in (9, 12, 15, 18)]
    assert hz == sorted(hz)
    assert hz[0] < 0.7 * hz[-1]


@pytest.mark.parametrize("counts", [600, 4096])
def test_the_acceleration_noise_is_what_quantisation_makes(counts: int) -> None:
    step = 2 * np.pi / counts
    errors = []
    claimed = []
    for seed in range(6):
        q = motion(np.random.default_rng(seed))
        rounded = quantise(q, step)
        cutoff = chosen(rounded, RATE)
        lowpass = Lowpass(cutoff.hz, RATE)
        _, ddq = differentiate(lowpass(rounded - q), RATE)
        errors.append(ddq[500:-500].std(axis=0))
        claimed.append(cutoff.acceleration_noise)
    # The formula has a brick wall where the filter rolls off: their noises differ by
    # sqrt 0.8.
    roll_off = np.sqrt(5 / 8 * 1.4346 * 0.8889)
    measured = np.sqrt(np.mean(np.square(errors)))
    assert roll_off * np.sqrt(np.mean(np.square(claimed))) == pytest.approx(
        measured, rel=0.15
    )


def test_white_noise_without_steps_is_measured() -> None:
    rng = np.random.default_rng(3)
    std = 2e-3
    q = motion(rng, 40.0) + std * rng.standard_normal((20000, 2))
    np.testing.assert_allclose(
        chosen(q, RATE).noise_density, std**2 * 2 / RATE, rtol=0.2
    )


def test_the_motion_passes_below_the_cutoff() -> None:
    """The filter takes less than a percent of the true acceleration's power."""
    q = motion(np.random.default_rng(4))
    full = differentiate(q, RATE)[1][500:-500]
    for counts in (600, 2**17):
        cutoff = chosen(quantise(q, 2 * np.pi / counts), RATE)
        passed = differentiate(Lowpass(cutoff.hz, RATE)(q), RATE)[1][500:-500]
        assert np.mean((full - passed) ** 2) < 0.01 * np.mean(full**2)


def test_joints_that_rest_do_not_vote() -> None:
    step = 2 * np.pi / 4096
    q = quantise(motion(np.random.default_rng(6)), step)
    rested = np.column_stack([q[:, 0], np.full(len(q), quantise(np.array(0.2), step))])
    assert chosen(rested, RATE).hz == pytest.approx(chosen(q[:, :1], RATE).hz)


def test_a_robot_file_overrules_the_step_seen() -> None:
    q = motion(np.random.default_rng(7))
    cutoff = chosen(q, RATE, resolution=np.array([0.01, 0.0]))
    assert cutoff.encoder_step[0] == 0.01
    assert cutoff.hz < chosen(q, RATE).hz


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
@pytest.mark.parametrize("counts", [200, 600, 2400, 2**20])
def test_a_coarse_encoder_is_no_fast_motion(rate_hz: float, counts: int) -> None:
    t = np.arange(round(20.0 * rate_hz)) / rate_hz
    sine = 0.8 * np.sin(2 * np.pi * t)
    # Back and forth at a constant speed, counts pass at a constant rate: tones, no
    # white noise.
    speed = np.clip(4.0 * np.abs((0.3 * t) % 1.0 - 0.5) - 1.0, -0.2, 0.2) * 3.0
    q = np.column_stack([sine, np.cumsum(speed) / rate_hz])
    rounded = quantise(q, 2 * np.pi / counts)
    resolution = np.full(2, 2 * np.pi / counts)
    for joint, hz in ((0, 1.0), (1, 1.5)):
        survey = Survey.of(rounded[:, [joint]], rate_hz)
        score = survey.score(resolution[:1], np.array([1.0, 2.0]))
        assert score is not None
        assert score.bandwidth_hz == pytest.approx(hz, abs=0.2)


def test_noise_shares_are_those_of_the_worst_joint() -> None:
    q = motion(np.random.default_rng(5))
    q[:, 1] *= 0.1
    rounded = quantise(q, 2 * np.pi / 2400)
    cutoffs = np.array([2.0, 4.0, 8.0])
    score = Survey.of(rounded, RATE).score(np.full(2, 2 * np.pi / 2400), cutoffs)
    assert score is not None
    assert score.shares is not None
    worst = score.shares.of_acceleration()
    by_joint = score.shares.acceleration_noise / score.shares.acceleration
    np.testing.assert_allclose(worst, by_joint[1], rtol=0.2)
    assert worst[2] == pytest.approx(32.0 * worst[1], rel=0.1)


@pytest.mark.parametrize("step", [0.0, 3e-7, 1e-5, 1e-3])
def test_steps_of_a_long_log_are_those_of_all_samples(step: float) -> None:
    """A few windows of its values tell that it has none."""
    rng = np.random.default_rng(2)
    t = np.arange(100_000) * 1e-3
    position = np.sin(t) + 1e-4 * rng.normal(size=len(t))
    if step:
        position = step * np.round(position / step)
    by_all = step_between(np.unique(np.round(position, 10)))
    assert is_continuous(position) == (by_all == 0.0)
    assert step_of(position) == by_all
    assert by_all == pytest.approx(step, rel=1e-3)
