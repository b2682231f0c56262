"""From a recording to joint motion, whole and by blocks: gaps are kept out."""

from collections.abc import Iterator

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.long import Block
from seqid_cli.logs.recording import Recording
from seqid_cli.motion import blocks as module
from seqid_cli.motion.blocks import joined, make_plan, motion_blocks
from seqid_cli.motion.filters.survey import Survey
from seqid_cli.motion.motion import Motion, decimated, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask, noise_step
from seqid_cli.typing import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r
from tests.plants.sensors import quantise
from tests.unit.logs.samples import make_robot

RATE = 500.0


def curves(samples: int = 6000) -> tuple[Array, Array, Array]:
    t = np.arange(samples) / RATE
    w = np.array([2.0, 3.1])
    phase = np.array([0.3, 1.0])
    angle = t[:, None] * w + phase
    return np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)


def motion_of(
    q: Array,
    hz: float | None = None,
    tau: Array | None = None,
    invalid: Array | None = None,
) -> Motion:
    log = made_recording(q, tau, rate_hz=RATE)
    log.valid[[] if invalid is None else invalid] = False
    return estimate_motion(log, planar_2r(), MotionOptions(cutoff_hz=hz))


def test_velocity_and_acceleration_are_the_true_ones() -> None:
    q, dq, ddq = curves()
    motion = motion_of(quantise(q, 2 * np.pi / 2**14))
    usable = motion.usable
    assert usable.sum() > 0.8 * len(q)
    assert np.sqrt(np.mean((motion.dq - dq)[usable] ** 2)) < 0.005
    allowed = 2 * motion.cutoff.acceleration_noise + 0.01 * np.abs(ddq).max(axis=0)
    assert (np.sqrt(np.mean((motion.ddq - ddq)[usable] ** 2, axis=0)) < allowed).all()


@pytest.mark.parametrize("hz", [2.0, 8.0, 30.0])
def test_parallel_filtering_keeps_a_linear_equation_exact(hz: float) -> None:
    """With tau = a q + c the filtered sides agree, whatever the cut-off."""
    q = curves(3000)[0]
    q = q + 0.05 * np.random.default_rng(0).standard_normal(q.shape)
    tau = 3.0 * q + 0.7
    motion = motion_of(q, hz, tau)
    np.testing.assert_allclose(
        motion.tau, motion.filtered(3.0 * motion.q + 0.7), atol=1e-9
    )
    np.testing.assert_allclose(motion.filtered(tau, times=2), motion.tau, atol=1e-12)


def test_samples_near_ends_and_gaps_are_not_usable() -> None:
    q = curves()[0]
    motion = motion_of(q, 10.0, invalid=np.arange(3000, 3010))
    margin = 2 * motion.lowpass.settling
    expected = np.zeros(len(q), dtype=bool)
    expected[margin : 3000 - margin] = expected[3010 + margin : len(q) - margin] = True
    np.testing.assert_array_equal(motion.usable, expected)


def test_a_log_of_gaps_is_refused() -> None:
    with pytest.raises(
        InputError, match="long enough for a low-pass of 5 Hz"
    ) as caught:
        motion_of(curves(2000)[0], 5.0, invalid=np.arange(0, 2000, 50))
    assert "log.parquet" in str(caught.value)


def test_a_sample_next_to_a_dropped_gap_is_invalid() -> None:
    # between kept ones
    short = decimated(motion_of(curves()[0], 5.0, invalid=np.array([3003])))
    assert short.valid[[299, 300, 301]].tolist() == [True, False, True]


SAMPLES = 9_137
STEP = 1e-4


@pytest.fixture(scope="module")
def log() -> Recording:
    """Two joints that move, one that stands still for a while, two gaps."""
    t = np.arange(SAMPLES) / RATE
    late_mover = np.where(t > 8, 0.2 * np.sin(t), 0.0)
    q = np.stack([np.sin(1.3 * t), 0.4 * np.cos(4.0 * t), late_mover], axis=1)
    q = STEP * np.round(q / STEP)
    tau = 3.0 * q + np.random.default_rng(8).normal(size=q.shape)
    recording = made_recording(q, tau, rate_hz=RATE)
    recording.valid[2_000:2_300] = recording.valid[7_777:7_779] = False
    return recording


def in_parts(recording: Recording, sizes: list[int]) -> Iterator[Block]:
    start = 0
    turn = 0
    while start < len(recording.t):
        part = slice(start, start + sizes[turn % len(sizes)])
        yield Block(
            start, recording.q[part], recording.tau[part], recording.valid[part]
        )
        start = part.stop
        turn = turn + 1


@pytest.mark.parametrize("least", [700, 4_096, 100_000])
def test_motion_by_blocks_is_the_whole_motion(
    log: Recording, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LEAST_BLOCK", least)
    expected = decimated(estimate_motion(log, make_robot(), MotionOptions()))
    step = noise_step(log.q, np.zeros(3))
    plan = make_plan(RATE, expected.cutoff, step, samples_per_cutoff=10)
    parts = list(motion_blocks(in_parts(log, [500, 77, 1_333]), plan))
    assert len(parts) > 1 or least > SAMPLES
    by_blocks = joined(parts)
    assert by_blocks.rate_hz == expected.rate_hz
    np.testing.assert_allclose(by_blocks.t, expected.t, rtol=1e-14)
    for name, order in {"q": 0, "dq": 1, "ddq": 2, "tau": 0}.items():
        # A derivative multiplies the rounding of the position by the rate.
        scale = np.abs(log.tau if name == "tau" else log.q).max() * RATE**order
        off = getattr(by_blocks, name) - getattr(expected, name)
        assert np.abs(off).max() < 1e-12 * scale, name
    for name in ("moving", "usable", "valid"):
        np.testing.assert_array_equal(getattr(by_blocks, name), getattr(expected, name))


@pytest.mark.parametrize("resolution", [0.0, STEP])
def test_a_survey_in_parts_is_that_of_the_whole_log(
    log: Recording, resolution: float
) -> None:
    resolutions = np.full(3, resolution)
    survey = Survey(3, RATE, SAMPLES)
    for block in in_parts(log, [911]):
        survey.push(block.q)
    step = noise_step(log.q, resolutions)
    np.testing.assert_allclose(survey.noise_step(resolutions), step, rtol=1e-12)
    moving = np.any(moving_mask(log.q, RATE, step), axis=0)
    np.testing.assert_array_equal(survey.moving(step), moving)
    expected = Survey.of(log.q, RATE).cutoff(resolutions)
    in_blocks = survey.cutoff(resolutions)
    for name in ("hz", "encoder_step", "noise_density"):
        np.testing.assert_allclose(
            getattr(in_blocks, name), getattr(expected, name), rtol=1e-9
        )
