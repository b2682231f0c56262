"""Noise: its floor, what encoders make of it, and whether what is left is white."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import NoiseFloor, encoder_residuals, noise_floor, rms
from seqid_cli.discover.noise.spectra import Spectrum, level_of, power_gain
from seqid_cli.discover.noise.whiteness import white
from seqid_cli.discover.scenes import scenes_of, with_own_cutoffs
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Joint, Robot
from tests import Array
from tests.plants.arms.rigs import plain, two_joint
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.motions.experiments import span_of
from tests.plants.motions.trajectories import fourier
from tests.plants.robots.sample import sample_robot
from tests.plants.sensors import noise, quantise
from tests.plants.simulate import simulate
from tests.unit.discover.drawn_logs import (
    CUTOFF_HZ,
    RATE_HZ,
    low_passed,
    recording,
    resting,
    scenes,
    smooth_torque,
    wander,
)

STD = np.array([1.0, 0.3])  # N m, of the raw torque
FREQUENCY = np.arange(0.4, 80.0, 0.2)
LOOSE = 3.0  # what the residual is larger by than noise


def silent(found: list[Scene]) -> list[Array]:
    """What encoders without noise make of the torque."""
    return [np.zeros_like(scene.motion.q) for scene in found]


def ratio(
    logs: list[Array], *, coloured: float, step: float, seed: int, hunting: float = 0.0
) -> tuple[Array, NoiseFloor]:
    """Floor over the true RMS of low-passed noise (n,); torque hunts at rest by so much of it."""
    rng = np.random.default_rng(seed)
    signal = [smooth_torque(q) + hunting * _hunted(q) for q in logs]
    raw = [noise(rng, len(q), STD, coloured=coloured, rate_hz=RATE_HZ) for q in logs]
    total = [quantise(s + e, step * STD) for s, e in zip(signal, raw, strict=True)]
    recordings = [recording(q, tau) for q, tau in zip(logs, total, strict=True)]
    found, rows = scenes(recordings)
    left = [low_passed(t - s, x) for t, s, x in zip(total, signal, found, strict=True)]
    truth = np.array([rms(rows.of(j, [r[:, j] for r in left])) for j in range(2)])
    # What a model of the motion misses repeats with it, and so is above the floor.
    missed = [np.cos(3 * x.motion.q) for x in found]
    scale = LOOSE * truth
    given = [r + scale * m for r, m in zip(left, missed, strict=True)]
    floor = noise_floor(recordings, found, given, silent(found), rows=rows)
    return floor.rms / truth, floor


def _hunted(q: Array) -> Array:
    """Torque (N, 2) N m of a controller that goes to and fro while all joints stand."""
    still = np.all(np.gradient(q, axis=0) == 0.0, axis=1)
    saw = np.cumsum(np.sign(np.sin(np.arange(len(q)) / 40.0))) / 40.0
    return np.asarray(STD * (still * saw)[:, None])


@pytest.mark.parametrize(("coloured", "step"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.5)])
def test_rests_give_the_noise_on_average(coloured: float, step: float) -> None:
    drawn = [ratio([resting(80.0, 6.0, s)], coloured=coloured, step=step, seed=s) for s in range(4)]
    assert abs(np.mean([found for found, _ in drawn]) - 1.0) < 0.15


@pytest.mark.parametrize(("coloured", "off"), [(0.0, 0.1), (0.5, 0.35)])
def test_noise_shows_above_the_cutoff_of_any_motion(coloured: float, off: float) -> None:
    found, floor = ratio([wander(60.0, 4)], coloured=coloured, step=0.0, seed=4)
    np.testing.assert_allclose(found, 1.0, atol=off)
    np.testing.assert_array_less(floor.low / floor.rms * found, 1.0)
    np.testing.assert_array_less(1.0, floor.high / floor.rms * found)
    # What colour it has in the band, motion does not tell: it may be all that is left.
    assert np.all(floor.high / floor.rms * found > 0.93 * np.sqrt(1.0 + LOOSE**2 / 2.0))


def test_the_residual_does_not_bound_the_floor() -> None:
    q = wander(30.0, 6)
    tau = np.random.default_rng(0).standard_normal(q.shape)
    log = recording(q, tau)
    found, rows = scenes([log])
    left = low_passed(tau, found[0])
    slow = Lowpass(1.5, found[0].motion.rate_hz)
    small = [left - slow(left)]
    floor = noise_floor([log], found, small, silent(found), rows=rows)
    truth = np.array([rms(rows.of(j, [left[:, j]])) for j in range(2)])
    result = np.array([rms(rows.of(j, [small[0][:, j]])) for j in range(2)])
    assert np.all(result < 0.95 * truth)
    np.testing.assert_allclose(floor.rms, truth, rtol=0.2)
    assert np.all(floor.low < truth)
    assert np.all(floor.high > truth)
    # Without rests slow noise may be more than shows, of all that is left as much as any has.
    slow_tone = np.cos(3.0 * found[0].motion.q)
    much, more = (
        noise_floor([log], found, [small[0] + size * slow_tone], silent(found), rows=rows)
        for size in (1.0, 20.0)
    )
    assert np.all(much.high > 0.5)
    assert np.all((much.high < more.high) & (more.high < 20.0 * more.rms))


def test_less_than_the_interval_makes_the_floor_doubtful() -> None:
    floor = NoiseFloor(np.full(3, 2.0), np.full(3, 1.5), np.full(3, 3.0))
    arm = (Joint("lift", prismatic=True), Joint("knee"), Joint("foot"))
    (note,) = floor.doubts(np.array([1.4, 1.6, np.nan]), arm)
    assert note.startswith("joint lift: 1.4 N is left")
    assert "1.5 to 3 N:" in note


@pytest.mark.parametrize(("hunting", "off"), [(0.0, 0.3), (30.0, 0.4)])
def test_a_controller_that_hunts_at_rest_is_no_noise(hunting: float, off: float) -> None:
    """Held at a count's edge a joint's torque goes to and fro; in motion it does not."""
    q = resting(80.0, 6.0, 6)
    found, floor = ratio([q], coloured=0.0, step=0.0, seed=6, hunting=hunting)
    np.testing.assert_allclose(found, 1.0, atol=off)
    np.testing.assert_array_less(floor.low / floor.rms * found, 1.0)


@pytest.mark.parametrize("slow", [False, True])
def test_rests_with_more_than_all_that_is_left_are_passed_over(*, slow: bool) -> None:
    q = resting(80.0, 6.0, 6)
    still = np.all(np.gradient(q, axis=0) == 0.0, axis=1)
    white, more = np.random.default_rng(0).standard_normal((2, *q.shape))
    tau = white + still[:, None] * (0.5 * np.cumsum(more, axis=0) if slow else 30.0 * more)
    log = recording(q, tau)
    found, rows = scenes([log])
    left = np.where(found[0].slides, low_passed(tau * ~still[:, None], found[0]), 0.0)
    floor = noise_floor([log], found, [left], silent(found), rows=rows)
    truth = np.array([rms(left[found[0].slides[:, j], j]) for j in range(2)])
    assert np.all(floor.low <= truth)
    assert np.all(floor.high >= truth)
    if not slow:
        np.testing.assert_allclose(floor.rms, truth, rtol=0.3)


def spectrum(rng: np.random.Generator, law: Array, *, averaged: float = 20.0) -> Spectrum:
    """A spectrum with the scatter of so many periodograms about a law (F,) of FREQUENCY."""
    scatter = rng.gamma(averaged, 1.0 / averaged, len(law))
    return Spectrum(FREQUENCY, law * scatter, np.full(len(law), averaged))


@pytest.mark.parametrize("flicker", [0.0, 8.0])
def test_what_spectra_hold_beside_noise_is_no_noise(flicker: float) -> None:
    """Of three spectra one is all excess, and one has a hump."""
    rng = np.random.default_rng(2)
    law = 1.0 + flicker / FREQUENCY
    hump = 1.0 + 30.0 * np.exp(-(((FREQUENCY - 6.0) / 2.0) ** 2))
    spectra = [spectrum(rng, law * more) for more in (1.0, hump, 20.0)]
    (scene,), _ = scenes([recording(wander(60.0, 1), np.zeros((30000, 2)))])
    slid = [(scene.motion, 60.0)]
    alone = level_of(spectra[:1], CUTOFF_HZ).rms(slid)
    middle, low, high, most = level_of(spectra, CUTOFF_HZ).rms(slid)
    f = np.linspace(0.01, 3.0 * CUTOFF_HZ, 3000)
    white = np.sqrt(np.trapezoid(2.0 * power_gain(scene.motion.lowpass, f, 2), f))
    assert low < middle < high <= most
    short = level_of(spectra, CUTOFF_HZ).rms([(scene.motion, 2.0)])
    assert short[2] / short[1] > 1.3 * high / low
    assert middle == pytest.approx(alone[0], rel=0.1)
    if flicker:
        assert middle > 1.2 * white
    else:
        assert middle == pytest.approx(white, rel=0.1)


def test_the_encoders_part_adds_to_torque_noise() -> None:
    rng = np.random.default_rng(1)
    q = resting(40.0, 6.0, 3)
    tau = STD * rng.standard_normal(q.shape)
    log = recording(q, tau)
    found, rows = scenes([log])
    left = low_passed(tau, found[0])
    echo = 1.5 * rng.permutation(left)
    alone = noise_floor([log], found, [left], silent(found), rows=rows)
    both = noise_floor([log], found, [left], [echo], rows=rows)
    heard = np.array([rms(rows.torque(j, [echo[:, j]])) for j in range(2)])
    np.testing.assert_allclose(both.rms, np.hypot(alone.rms, heard), rtol=0.1)
    assert np.all(both.low < both.rms)


Case = tuple[Scene, Rows, int]  # scene, rows, samples of the log

IN_BAND = np.sqrt(2 * CUTOFF_HZ / RATE_HZ)  # RMS of unit white noise after the low-pass


def case(q: Array) -> Case:
    found, rows = scenes([recording(q, np.zeros_like(q))])
    return found[0], rows, len(q)


@pytest.fixture(scope="module")
def moving() -> Case:
    return case(wander(30.0, 1))


def rejected(case: Case, extra: Array, draws: int, seed: int) -> float:
    """Share of residuals, low-passed noise and `extra` (N, 2), that are called coloured."""
    scene, rows, samples = case
    rng = np.random.default_rng(seed)
    count = 0
    for _ in range(draws):
        values = rng.standard_normal((samples, 2)) + extra
        count += int(np.sum(~white(rows, [low_passed(values, scene)])))
    return count / (2 * draws)


@pytest.mark.parametrize(("rests", "draws", "most"), [(False, 150, 10), (True, 75, 7)])
def test_low_passed_white_noise_passes_at_the_promised_rate(
    moving: Case, *, rests: bool, draws: int, most: int
) -> None:
    # 3 of 300 are expected; 11 or more would be seen once in five thousand times.
    found = case(resting(30.0, 1.0, 1)) if rests else moving
    assert rejected(found, np.zeros((found[2], 2)), draws, 2) <= most / (2 * draws)


@pytest.mark.parametrize("hz", [0.0, 0.4, 3.0, 6.0])
def test_a_sine_of_half_the_noise_and_slow_noise_of_its_size_are_seen(
    moving: Case, hz: float
) -> None:
    t = np.arange(moving[2]) / RATE_HZ
    wave = 0.5 * np.sqrt(2) * np.sin(2 * np.pi * hz * t)[:, None] * np.ones(2)
    drive = np.random.default_rng(5).standard_normal((moving[2], 2))
    slow = lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], drive, axis=0)
    assert rejected(moving, IN_BAND * (wave if hz else slow), 20, 4) > 0.8


def test_too_few_samples_are_not_judged() -> None:
    scene, rows, samples = case(wander(3.0, 2))
    line = np.tile(np.sin(np.arange(samples) / RATE_HZ * 2)[:, None], (1, 2))
    assert white(rows, [low_passed(line, scene)]).all()


JOINTS, SECONDS, EVERY = 2, 30.0, 2


@pytest.fixture(scope="module")
def log() -> Recording:
    """A log of the two-joint rig with Coulomb and viscous friction, 500 Hz."""
    plant = two_joint()
    assert isinstance(plant.friction, SurfaceFriction)
    plant = replace(plant, friction=plain(plant.friction))
    low, high = np.array([span_of(plant, j) for j in range(JOINTS)]).T
    limits = (0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits)
    rng = np.random.default_rng(5)
    motion = fourier(rng, low, high, *limits, seconds=SECONDS, harmonics=24, rate_hz=1000.0)
    found = simulate(plant, motion, 0, every=EVERY, imus=False)
    return recording(found.q, found.current * plant.torque_per_ampere, 1000.0 / EVERY)


@pytest.fixture(scope="module")
def identified(log: Recording) -> tuple[Robot, Stages]:
    robot = sample_robot("two_joint")
    friction, inertia = identify_simultaneous([log], robot, options=MotionOptions())
    return robot, Stages(friction=friction, inertia=inertia)


@pytest.mark.slow
def test_the_encoders_part_is_smaller_than_what_is_left(
    log: Recording, identified: tuple[Robot, Stages]
) -> None:
    (scene,) = scenes_of([log], *identified, options=InertiaOptions())
    (echo,) = encoder_residuals([log], [scene])
    left, slides = residual_of(scene), scene.slides
    for j in range(JOINTS):
        assert 0.01 * rms(left[slides[:, j], j]) < rms(echo[slides[:, j], j])
        assert rms(echo[slides[:, j], j]) < rms(left[slides[:, j], j])


@pytest.mark.slow
def test_a_log_whose_encoders_are_too_coarse_is_filtered_at_its_own_cutoff(
    log: Recording, identified: tuple[Robot, Stages]
) -> None:
    robot, stages = identified
    own = estimate_motion(log, robot, MotionOptions()).cutoff.hz
    larger = replace(log, tau=log.tau + 20.0 * np.std(log.tau, axis=0) * np.sin(3.0 * log.q))
    for given, origin, expected in (
        (log, "of the inertia stage", own),
        (log, "as given", 4.0 * own),
        (larger, "of the inertia stage", 4.0 * own),  # noise is no part of what is left there
    ):
        options = InertiaOptions(MotionOptions(4.0 * own, origin=origin), source="needed")
        options = with_own_cutoffs([given], robot, stages, options)
        (scene,) = scenes_of([given], robot, stages, options=options)
        assert scene.motion.cutoff.hz == pytest.approx(expected)
