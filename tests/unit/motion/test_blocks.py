"""Motion and survey of a log block by block against those of the log as a whole."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from seqid_cli.logs.long import Block
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.motion import blocks as module
from seqid_cli.motion.blocks import Plan, joined, make_plan, motion_blocks
from seqid_cli.motion.filters.survey import Survey, Welch
from seqid_cli.motion.motion import Motion, decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step
from tests.unit.logs.samples import make_robot

RATE_HZ = 500.0
SAMPLES = 9_137
STEP = 1e-4
NAMES = ("q", "dq", "ddq", "tau", "moving", "usable", "valid")


def log() -> Recording:
    """Two joints that move, one that stands still for a while, two gaps."""
    rng = np.random.default_rng(8)
    t = np.arange(SAMPLES) / RATE_HZ
    q = np.stack([np.sin(1.3 * t), 0.4 * np.cos(4.0 * t), 0.2 * np.sin(t) * (t > 8)], axis=1)
    q = STEP * np.round(q / STEP)
    tau = 3.0 * q + rng.normal(size=q.shape)
    valid = np.ones(SAMPLES, dtype=bool)
    valid[2_000:2_300] = valid[7_777:7_779] = False
    return Recording(Path("log"), "", "parquet", t, q, valid, Health(RATE_HZ, 0.0), tau=tau)


def in_parts(recording: Recording, sizes: list[int]) -> Iterator[Block]:
    """The samples in blocks of the given sizes, over and over."""
    start, turn = 0, 0
    while start < len(recording.t):
        part = slice(start, start + sizes[turn % len(sizes)])
        yield Block(start, recording.q[part], recording.tau[part], recording.valid[part])
        start, turn = part.stop, turn + 1


def whole_motion(recording: Recording) -> Motion:
    """What the log held in memory gives."""
    return decimated(estimate_motion(recording, make_robot(), MotionOptions()))


def plan_for(recording: Recording, motion: Motion) -> Plan:
    """The plan that leads to the same motion."""
    step = noise_step(recording.q, np.zeros(recording.q.shape[1]))
    return make_plan(RATE_HZ, motion.cutoff, step, samples_per_cutoff=10)


@pytest.mark.parametrize("least", [700, 4_096, 100_000])
def test_motion_by_blocks_is_the_whole_motion(least: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LEAST_BLOCK", least)
    recording = log()
    expected = whole_motion(recording)
    assert recording.tau is not None
    plan = plan_for(recording, expected)
    parts = list(motion_blocks(in_parts(recording, [500, 77, 1_333]), plan))
    assert len(parts) > 1 or least > SAMPLES
    found = joined(parts)
    assert found.rate_hz == expected.rate_hz
    np.testing.assert_allclose(found.t, expected.t, rtol=1e-14)
    for name, order in zip(NAMES[:4], (0, 1, 2, 0), strict=True):
        values, wanted = getattr(found, name), getattr(expected, name)
        # A derivative multiplies the rounding of the position by the rate.
        scale = np.abs(recording.tau if name == "tau" else recording.q).max() * RATE_HZ**order
        assert np.abs(values - wanted).max() < 1e-12 * scale, name
    for name in NAMES[4:]:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("resolution", [0.0, STEP])
def test_a_survey_in_parts_chooses_as_that_of_the_whole_log(resolution: float) -> None:
    recording = log()
    known = np.full(3, resolution)
    survey = Survey(3, RATE_HZ, SAMPLES)
    for block in in_parts(recording, [911]):
        survey.push(block.q)
    step = noise_step(recording.q, known)
    np.testing.assert_allclose(survey.noise_step(known), step, rtol=1e-12)
    moving = np.asarray(np.any(moving_mask(recording.q, RATE_HZ, step), axis=0))
    np.testing.assert_array_equal(survey.moving(step), moving)
    expected = Survey.of(recording.q, RATE_HZ).cutoff(known)
    found = survey.cutoff(known)
    assert found.hz == pytest.approx(expected.hz, rel=1e-12)
    assert found.bias == pytest.approx(expected.bias, rel=1e-9)
    np.testing.assert_allclose(found.encoder_step, expected.encoder_step)
    np.testing.assert_allclose(found.noise_density, expected.noise_density, rtol=1e-9)


@pytest.mark.parametrize("samples", [256, 1_000, 4_001])
def test_the_spectrum_is_welchs(samples: int) -> None:
    values = np.random.default_rng(9).normal(size=(samples, 2))
    spectrum = Welch(256)
    wanted = 0
    for end in [*range(37, samples, 37), samples]:
        wanted = spectrum.look(values[wanted:end], wanted)
    frequency, density = spectrum.density(100.0)
    expected_frequency, expected = welch(values.T, 100.0, nperseg=256, detrend=False)
    np.testing.assert_allclose(frequency, expected_frequency)
    np.testing.assert_allclose(density, expected, rtol=1e-10, atol=1e-14)
