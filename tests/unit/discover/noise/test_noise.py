"""Noise: its floor, what encoders make of it, and whether what is left is white."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import (
    NoiseFloor,
    encoder_residuals,
    noise_floor,
    rms,
)
from seqid_cli.discover.noise.whiteness import white
from seqid_cli.discover.scenes import scenes_of, with_own_cutoffs
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.scene import Scene
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.torque_noise import Spectrum, level_of, power_gain
from seqid_cli.robot.types import Joint
from tests import Array
from tests.plants.robots.sample import Rig, sample_rig
from tests.plants.sensors import noise, quantise
from tests.unit.discover.drawn_logs import (
    CUTOFF_HZ,
    RATE_HZ,
    low_passed,
    recording,
    resting,
    scene_of,
    smooth_torque,
    wander,
)

STD = np.array([1.0, 0.3])  # N m, of the raw torque
FREQUENCY = np.arange(0.4, 80.0, 0.2)
LOOSE = 3.0  # what the residual is larger by than noise


def floor_of(
    log: Recording, left: Array, seen: tuple[Scene, Rows], echo: Array | None = None
) -> NoiseFloor:
    """The floor of one log, from what is left of its torque and what encoders make."""
    encoder = np.zeros_like(left) if echo is None else echo
    return noise_floor([log], seen[:1], [left], [encoder], rows=seen[1])


def rms_of(values: Array, rows: Rows) -> Array:
    return np.array([rms(rows.of(j, [values[:, j]])) for j in range(2)])


def ratio(
    q: Array,
    *,
    coloured: float = 0.0,
    step: float = 0.0,
    seed: int,
    hunting: float = 0.0,
) -> tuple[Array, NoiseFloor]:
    """Floor over the true RMS of low-passed noise (n,); torque hunts at rest by so much
    of it.
    """
    still = np.all(np.gradient(q, axis=0) == 0.0, axis=1)
    saw = np.cumsum(np.sign(np.sin(np.arange(len(q)) / 40.0))) / 40.0
    signal = smooth_torque(q) + hunting * np.outer(still * saw, STD)
    raw = noise(
        np.random.default_rng(seed), len(q), STD, coloured=coloured, rate_hz=RATE_HZ
    )
    total = quantise(signal + raw, step * STD)
    log = recording(q, total)
    seen = scene_of(log)
    left = low_passed(total - signal, seen[0])
    truth = rms_of(left, seen[1])
    # What a model of the motion misses repeats with it, and so is above the floor.
    floor = floor_of(log, left + LOOSE * truth * np.cos(3 * seen[0].motion.q), seen)
    return floor.rms / truth, floor


@pytest.mark.parametrize(("coloured", "step"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.5)])
def test_rests_give_the_noise_on_average(coloured: float, step: float) -> None:
    drawn = [
        ratio(resting(80.0, 6.0, s), coloured=coloured, step=step, seed=s)
        for s in range(4)
    ]
    assert abs(np.mean([found for found, _ in drawn]) - 1.0) < 0.15


@pytest.mark.parametrize(("coloured", "off"), [(0.0, 0.1), (0.5, 0.35)])
def test_noise_shows_above_the_cutoff_of_any_motion(
    coloured: float, off: float
) -> None:
    found, floor = ratio(wander(60.0, 4), coloured=coloured, seed=4)
    np.testing.assert_allclose(found, 1.0, atol=off)
    np.testing.assert_array_less(floor.low / floor.rms * found, 1.0)
    np.testing.assert_array_less(1.0, floor.high / floor.rms * found)
    # What colour it has in the band, motion does not tell: it may be all that is left.
    assert np.all(floor.high / floor.rms * found > 0.93 * np.sqrt(1.0 + LOOSE**2 / 2.0))


def test_the_residual_does_not_bound_the_floor() -> None:
    q = wander(30.0, 6)
    tau = np.random.default_rng(0).standard_normal(q.shape)
    log = recording(q, tau)
    seen = scene_of(log)
    scene = seen[0]
    left = low_passed(tau, scene)
    small = left - Lowpass(1.5, scene.motion.rate_hz)(left)
    floor, truth = floor_of(log, small, seen), rms_of(left, seen[1])
    assert np.all(rms_of(small, seen[1]) < 0.95 * truth)
    np.testing.assert_allclose(floor.rms, truth, rtol=0.2)
    assert np.all((floor.low < truth) & (truth < floor.high))
    # Without rests slow noise may be more than shows, of all that is left as much as
    # any has.
    tone = np.cos(3.0 * scene.motion.q)
    much, more = (floor_of(log, small + size * tone, seen) for size in (1.0, 20.0))
    assert np.all(much.high > 0.5)
    assert np.all((much.high < more.high) & (more.high < 20.0 * more.rms))


def test_less_than_the_interval_makes_the_floor_doubtful() -> None:
    floor = NoiseFloor(np.full(3, 2.0), np.full(3, 1.5), np.full(3, 3.0))
    arm = (Joint("lift", prismatic=True), Joint("knee"), Joint("foot"))
    (note,) = floor.doubts(np.array([1.4, 1.6, np.nan]), arm)
    assert note.startswith("joint lift: 1.4 N is left")
    assert "1.5 to 3 N:" in note


@pytest.mark.parametrize(("hunting", "off"), [(0.0, 0.3), (30.0, 0.4)])
def test_a_controller_that_hunts_at_rest_is_no_noise(
    hunting: float, off: float
) -> None:
    """Held at a count's edge a joint's torque goes to and fro, in motion not."""
    found, floor = ratio(resting(80.0, 6.0, 6), seed=6, hunting=hunting)
    np.testing.assert_allclose(found, 1.0, atol=off)
    np.testing.assert_array_less(floor.low / floor.rms * found, 1.0)


@pytest.mark.parametrize("slow", [False, True])
def test_rests_with_more_than_all_that_is_left_are_passed_over(*, slow: bool) -> None:
    q = resting(80.0, 6.0, 6)
    still = np.all(np.gradient(q, axis=0) == 0.0, axis=1)
    white, more = np.random.default_rng(0).standard_normal((2, *q.shape))
    tau = white + still[:, None] * (
        0.5 * np.cumsum(more, axis=0) if slow else 30.0 * more
    )
    log = recording(q, tau)
    seen = scene_of(log)
    slides = seen[0].slides
    left = np.where(slides, low_passed(tau * ~still[:, None], seen[0]), 0.0)
    floor = floor_of(log, left, seen)
    truth = np.array([rms(left[slides[:, j], j]) for j in range(2)])
    assert np.all((floor.low <= truth) & (truth <= floor.high))
    if not slow:
        np.testing.assert_allclose(floor.rms, truth, rtol=0.3)


@pytest.mark.parametrize("flicker", [0.0, 8.0])
def test_what_spectra_hold_beside_noise_is_no_noise(flicker: float) -> None:
    """Of three spectra one is all excess, and one has a hump."""
    rng = np.random.default_rng(2)
    law = 1.0 + flicker / FREQUENCY
    hump = 1.0 + 30.0 * np.exp(-(((FREQUENCY - 6.0) / 2.0) ** 2))
    spectra = []
    for more in (1.0, hump, 20.0):  # with the scatter of 20 periodograms
        scatter = rng.gamma(20.0, 1.0 / 20.0, len(law))
        spectra.append(
            Spectrum(FREQUENCY, law * more * scatter, np.full(len(law), 20.0))
        )
    scene, _ = scene_of(recording(wander(60.0, 1), np.zeros((30000, 2))))
    slid = [(scene.motion, 60.0)]
    alone = level_of(spectra[:1], CUTOFF_HZ).rms(slid)
    middle, low, high, most = level_of(spectra, CUTOFF_HZ).rms(slid)
    f = np.linspace(0.01, 3.0 * CUTOFF_HZ, 3000)
    white = np.sqrt(np.trapezoid(2.0 * power_gain(scene.motion.lowpass, f, 2), f))
    assert low < middle < high <= most
    short = level_of(spectra, CUTOFF_HZ).rms([(scene.motion, 2.0)])
    assert short[2] / short[1] > 1.3 * high / low
    assert middle == pytest.approx(alone[0], rel=0.1)
    assert middle > 1.2 * white if flicker else middle == pytest.approx(white, rel=0.1)


def test_the_encoders_part_adds_to_torque_noise() -> None:
    rng = np.random.default_rng(1)
    q = resting(40.0, 6.0, 3)
    tau = STD * rng.standard_normal(q.shape)
    log = recording(q, tau)
    seen = scene_of(log)
    left = low_passed(tau, seen[0])
    echo = 1.5 * rng.permutation(left)
    alone, both = (floor_of(log, left, seen, encoder) for encoder in (None, echo))
    heard = np.array([rms(seen[1].torque(j, [echo[:, j]])) for j in range(2)])
    np.testing.assert_allclose(both.rms, np.hypot(alone.rms, heard), rtol=0.1)
    assert np.all(both.low < both.rms)


IN_BAND = np.sqrt(2 * CUTOFF_HZ / RATE_HZ)  # RMS of unit white noise after the low-pass


def rejected(q: Array, extra: Array | float, draws: int, seed: int) -> float:
    """Share of residuals, low-passed noise and `extra` (N, 2), that are called
    coloured.
    """
    scene, rows = scene_of(recording(q, np.zeros_like(q)))
    rng = np.random.default_rng(seed)
    called = [
        ~white(rows, [low_passed(rng.standard_normal(q.shape) + extra, scene)])
        for _ in range(draws)
    ]
    return float(np.mean(called))


@pytest.mark.parametrize(("rests", "draws", "most"), [(False, 150, 10), (True, 75, 7)])
def test_low_passed_white_noise_passes_at_the_promised_rate(
    *, rests: bool, draws: int, most: int
) -> None:
    # 3 of 300 are expected; 11 or more would be seen once in five thousand times.
    q = resting(30.0, 1.0, 1) if rests else wander(30.0, 1)
    assert rejected(q, 0.0, draws, 2) <= most / (2 * draws)


@pytest.mark.parametrize("hz", [0.0, 0.4, 3.0, 6.0])
def test_a_sine_of_half_the_noise_and_slow_noise_of_its_size_are_seen(
    hz: float,
) -> None:
    moving = wander(30.0, 1)
    t = np.arange(len(moving)) / RATE_HZ
    wave = 0.5 * np.sqrt(2) * np.sin(2 * np.pi * hz * t)[:, None]
    drive = np.random.default_rng(5).standard_normal(moving.shape)
    slow = lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], drive, axis=0)
    assert rejected(moving, IN_BAND * (wave if hz else slow), 20, 4) > 0.8


def test_too_few_samples_are_not_judged() -> None:
    q = wander(3.0, 2)
    line = np.sin(np.arange(len(q)) / RATE_HZ * 2)[:, None]
    assert rejected(q, line, 1, 0) == 0.0


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The two-joint sample robot, whose encoders are coarse."""
    return sample_rig("two_joint")


@pytest.mark.slow
def test_the_encoders_part_is_smaller_than_what_is_left(rig: Rig) -> None:
    log = rig.logs("validation")[0]
    (scene,) = scenes_of([log], rig.robot, rig.simultaneous, options=InertiaOptions())
    (echo,) = encoder_residuals([log], [scene])
    for left, own, slides in zip(
        residual_of(scene).T, echo.T, scene.slides.T, strict=True
    ):
        assert 0.01 * rms(left[slides]) < rms(own[slides]) < rms(left[slides])


@pytest.mark.slow
def test_a_log_whose_encoders_are_too_coarse_is_filtered_at_its_own_cutoff(
    rig: Rig,
) -> None:
    robot, stages, log = rig.robot, rig.simultaneous, rig.logs("validation")[0]
    own = estimate_motion(log, robot, MotionOptions()).cutoff.hz
    larger = replace(
        log, tau=log.tau + 20.0 * np.std(log.tau, axis=0) * np.sin(3.0 * log.q)
    )
    for given, origin, expected in (
        (log, "of the inertia stage", own),
        (log, "as given", 4.0 * own),
        # noise is no part of what is left there
        (larger, "of the inertia stage", 4.0 * own),
    ):
        options = InertiaOptions(
            motion=MotionOptions(4.0 * own, origin=origin), source="needed"
        )
        options = with_own_cutoffs([given], robot, stages, options)
        (scene,) = scenes_of([given], robot, stages, options=options)
        assert scene.motion.cutoff.hz == pytest.approx(expected)
