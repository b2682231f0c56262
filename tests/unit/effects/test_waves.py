"""Waves: ripples by angle, lines in time; their frequency, law and size, and none of
the motion.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.effects.effect import Settings
from seqid_cli.effects.periodic_disturbance import Signal, strongest_lines
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.repetition import joint_period_s
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.torque_ripple import LAWS, TorqueRipple
from tests import Array
from tests.plants.robots.two_joint import GEAR, two_joint_robot
from tests.unit.effects.scenes import RATE_HZ, scene_of, wander

SIN = 0.6
COS = 0.8


def rippling(
    order: float, law: int, *, seed: int, gear: float = GEAR[1], lag: float = 0.0
) -> tuple[Scene, Array]:
    """Return a scene and its unfiltered residual: ripple, noise, a bump of position."""
    robot = two_joint_robot()
    joints = (
        robot.joints[0],
        replace(robot.joints[1], gear_ratio=None if gear == 1.0 else gear),
    )
    scene = scene_of(
        wander(30.0, seed=seed, amplitude=1.5), robot=replace(robot, joints=joints)
    )
    q = scene.motion.q[:, 1]
    v = scene.motion.dq[:, 1]
    rng = np.random.default_rng(seed)
    multipliers = (
        1.0,
        0.05 * scene.modelled[:, 1],
        np.sign(v),
        0.05 * scene.load[:, 1],
    )
    p = order * gear * (q - lag * v)
    ripple = multipliers[law] * (SIN * np.sin(p) + COS * np.cos(p))
    bump = 0.5 * np.exp(-((q - 0.4) ** 2))
    residual = rng.normal(size=scene.motion.q.shape)
    residual[:, 1] += ripple + bump
    residual[~scene.motion.usable] = 0.0
    return scene, residual


def best_of(
    scenes: Sequence[Scene], residual: Sequence[Array]
) -> tuple[Settings, Array]:
    """Return the point of the ripple's grid that leaves least, and its coefficients.

    It is of the second joint.
    """
    y = np.concatenate([r[:, 1] for r in residual])
    tried = []
    for settings in TorqueRipple().grid(scenes, 1, residual):
        X = np.concatenate(
            [TorqueRipple().columns(scene, 1, settings)[1] for scene in scenes]
        )
        c = np.linalg.lstsq(X[y != 0.0], y[y != 0.0])[0]
        tried.append((float(np.sum((y - X @ c)[y != 0.0] ** 2)), settings, c))
    assert len(tried) <= 20
    _, best, c = min(tried, key=lambda item: item[0])
    return best, c


@pytest.mark.slow
@pytest.mark.parametrize("law", range(len(LAWS)), ids=LAWS)
@pytest.mark.parametrize(
    ("order", "gear"), [(2.0, GEAR[1]), (6.0, GEAR[1]), (13.7, 1.0)]
)
def test_order_law_and_size_come_back(order: float, gear: float, law: int) -> None:
    """A whole number of cycles per motor turn is named as such."""
    scenes, residual = zip(
        *(rippling(order, law, seed=k, gear=gear) for k in (0, 1)), strict=True
    )
    best, c = best_of(scenes, residual)
    assert best["law"] == law
    assert best["order"] == pytest.approx(order, abs=0.0 if gear != 1.0 else 0.02)
    scale, unit = (0.05, "1") if LAWS[law] in ("torque", "load") else (1.0, "N m")
    size, phase = TorqueRipple().values(scenes[0].robot, 1, best, c, 1e-6 * np.eye(2))
    assert (size.value, size.unit) == (pytest.approx(scale, rel=0.1), unit)
    assert phase.value == pytest.approx(np.arctan2(COS, SIN), abs=0.15)


def test_a_ripple_that_comes_late_is_found_both_ways() -> None:
    """At some 20 Hz no sine of the angle itself holds for both directions."""
    scene, residual = rippling(2.0, 0, seed=3, lag=0.015)
    best, _ = best_of([scene], [residual])
    assert best == {"order": 2.0, "law": 0.0, "lag": 0.015}


def test_a_joint_that_hardly_moves_goes_through_too_few_waves() -> None:
    """Of 1970 waves per turn 0.03 rad have nine, however often they come by."""
    effect = TorqueRipple()
    fine = {"order": 1970.0 / GEAR[0], "law": 0.0, "lag": 0.0}
    usual = {**fine, "order": 1.0}
    hardly = [scene_of(wander(60.0, amplitude=0.008))]
    assert np.ptp(hardly[0].motion.q[:, 0]) < 0.04
    assert not effect.shows(hardly, 0, fine)
    assert not effect.shows(hardly, 0, usual)
    residual = [np.random.default_rng(0).normal(size=hardly[0].motion.q.shape)]
    assert not [*effect.grid(hardly, 0, residual)]

    far = [scene_of(wander(60.0, amplitude=1.5))]
    assert effect.shows(far, 0, usual)
    assert not effect.shows(far, 0, {**fine, "order": 3e5 / GEAR[0]})  # too fast


def test_few_waves_in_the_range_are_a_ripple_where_they_are_clear() -> None:
    """Of 21 waves per turn of the joint six are in its range, none per motor turn."""
    order = 21.0 / GEAR[1]
    settings = {"order": order, "law": 0.0, "lag": 0.0}
    scene = scene_of(wander(60.0, amplitude=0.5))
    q = scene.motion.q[:, 1]
    assert 3.0 < 21.0 * np.ptp(q) / (2.0 * np.pi) < 10.0
    ripple = TorqueRipple().columns(scene, 1, settings)[1] @ np.array([SIN, COS])

    def found(size: float) -> list[float]:
        noise = np.random.default_rng(4).normal(size=scene.motion.q.shape)
        residual = 0.3 * noise
        residual[:, 1] += size * ripple
        grid = TorqueRipple().grid([scene], 1, [residual])
        orders = [each["order"] for each in grid if each["law"] == 0.0]
        return [each for each in orders if abs(each / order - 1.0) < 0.05]

    assert found(1.0)
    assert not found(0.0)


def test_friction_over_the_position_is_held_where_no_log_was() -> None:
    effect = CATALOGUE["position_dependent_friction"]
    scene = scene_of(wander(12.0, amplitude=0.5))
    settings = next(iter(effect.grid([scene], 0, [])))
    q = scene.motion.q[:, 0]
    assert settings["lowest"] == pytest.approx(q.min())
    assert settings["highest"] == pytest.approx(q.max())

    wider = scene_of(wander(12.0, amplitude=1.5))
    columns = effect.columns(wider, 0, settings)[0]
    q = wider.motion.q[:, 0]
    above = q > settings["highest"]
    assert above.any()
    sign = wider.sign[:, 0]
    at_edge = np.cos(2 * np.pi * settings["highest"] / settings["period"])
    np.testing.assert_allclose(columns[above, 0], sign[above] * at_edge, atol=1e-9)

    # Files of before have no such range.
    of_before = {name: settings[name] for name in ("period", "waves")}
    columns = effect.columns(wider, 0, of_before)[0]
    np.testing.assert_allclose(columns[:, 0], sign * np.cos(q), atol=1e-9)


def test_usual_orders_are_tried_where_logs_are_too_fast_for_their_spectrum() -> None:
    """Two waves per turn of a large gear are above what most samples of a fast log
    resolve.

    Four waves per turn of the joint are a smooth function of position.
    """
    orders = []
    for gear in (400.0, 4.0):
        scene, residual = rippling(2.0, 0, seed=5, gear=gear)
        orders.append({s["order"] for s in TorqueRipple().grid([scene], 1, [residual])})
    assert {1.0, 2.0} <= orders[0]
    assert 1.0 not in orders[1]


EFFECT = CATALOGUE["periodic_disturbance"]
AMPLITUDE = 0.3
NOISE = 0.3


def logs(*, shared: bool = True) -> list[Scene]:
    starts = [300.0 * k + 17.3 * k**2 if shared else 0.0 for k in range(4)]
    return [
        scene_of(wander(20.0, seed=k), log=k, start=start, shared_clock=shared)
        for k, start in enumerate(starts)
    ]


def noise_like(scene: Scene, seed: int, size: float) -> Array:
    return np.random.default_rng(seed).normal(scale=size, size=scene.motion.q.shape)


def line(scene: Scene, frequency: float, phase: float = 0.7) -> Array:
    """A line on the first joint and noise on both, (N, n) N m."""
    torque = noise_like(scene, scene.log, NOISE)
    torque[:, 0] += AMPLITUDE * np.sin(2 * np.pi * frequency * scene.time + phase)
    return torque


def solved(
    scenes: Sequence[Scene], residual: Sequence[Array]
) -> tuple[Settings, Array, Array]:
    """Return the only line of the grid, its coefficients, and what they leave."""
    (settings,) = EFFECT.grid(scenes, 0, residual)
    X = np.concatenate([EFFECT.columns(s, 0, settings)[0] for s in scenes])
    y = np.concatenate([r[:, 0] for r in residual])
    c = np.linalg.lstsq(X, y)[0]
    return settings, c, y - X @ c


@pytest.mark.parametrize("frequency", [50.0, 49.987, 23.4567, 99.3])
def test_a_line_comes_back(frequency: float) -> None:
    """Its frequency to a fraction of the session; sizes within four of their standard
    errors.
    """
    scenes = logs()
    settings, c, _ = solved(scenes, [line(s, frequency) for s in scenes])
    assert settings["frequency"] == pytest.approx(
        frequency, abs=0.05 / scenes[-1].time[-1]
    )
    assert settings["clocks"] == 0.0
    X = np.concatenate([EFFECT.columns(s, 0, settings)[0] for s in scenes])
    covariance = NOISE**2 * np.linalg.inv(X.T @ X)
    values = {
        v.name: v for v in EFFECT.values(scenes[0].robot, 0, settings, c, covariance)
    }
    for name, truth in (("amplitude", AMPLITUDE), ("frequency", frequency)):
        assert 0.0 < values[name].std_error < 0.05 * truth
        assert abs(values[name].value - truth) < 4 * values[name].std_error


def test_logs_without_a_common_clock_have_their_own_phases() -> None:
    scenes = logs(shared=False)
    settings, c, residual = solved(
        scenes, [line(s, 50.0, phase=1.3 * s.log) for s in scenes]
    )
    assert settings["clocks"] == 4.0
    assert settings["frequency"] == pytest.approx(50.0, abs=0.005)
    assert np.std(residual) < 1.02 * NOISE
    values = EFFECT.values(scenes[0].robot, 0, settings, c, 1e-4 * np.eye(8))
    assert [v.name for v in values] == ["amplitude", "frequency"]
    assert values[0].value == pytest.approx(AMPLITUDE, rel=0.05)
    unknown = replace(scenes[0], log=4)
    assert not EFFECT.columns(unknown, 0, settings)[0].any()


def test_a_line_counts_where_the_joint_slides() -> None:
    """A log in which the joint rests most of the time says as much of the line while it
    moves.
    """
    moving = logs(shared=False)[0]
    resting = scene_of(wander(20.0, seed=7, rests=((2.0, 18.5),)), log=1)
    scenes = [moving, resting]
    residual = [np.where(scene.slides, line(scene, 5.3), 0.0) for scene in scenes]
    frequencies = [
        settings["frequency"] for settings in EFFECT.grid(scenes, 0, residual)
    ]
    assert frequencies[0] == pytest.approx(5.3, abs=0.02)
    assert np.mean(resting.slides[:, 0]) < 0.25 * np.mean(moving.slides[:, 0])


def test_nothing_in_noise_nor_on_the_other_joint() -> None:
    scenes = logs()
    noise = [noise_like(s, 50 + s.log, NOISE) for s in scenes]
    assert list(EFFECT.grid(scenes, 0, noise)) == []
    assert list(EFFECT.grid(scenes, 1, [line(s, 50.0) for s in scenes])) == []


def test_ripple_of_the_motor_is_no_line_in_time() -> None:
    """Constant speeds, one per log: a clean line in each, at another frequency."""
    scenes = []
    for k, speed in enumerate((0.5, 0.8, 1.1, 1.4)):
        t = np.arange(round(20 * RATE_HZ)) / RATE_HZ
        q = np.stack([speed * t, 0.0 * t], axis=1)
        scenes.append(scene_of(q, log=k, start=100.0 * k, shared_clock=True))
    ripple = [
        noise_like(s, s.log, NOISE) + np.sin(2 * 50.0 * s.motion.q[:, :1])
        for s in scenes
    ]
    assert list(EFFECT.grid(scenes, 0, ripple)) == []


def test_harmonics_of_the_motion_are_no_disturbance() -> None:
    """A share of the model's own torque is missing: all lines of the residual are the
    motion's.
    """
    t = np.arange(round(20 * RATE_HZ)) / RATE_HZ
    q = np.stack([0.5 * np.sin(2 * np.pi * t), 0.5 * np.cos(2 * np.pi * t)], axis=1)
    scenes = [scene_of(q, log=k, start=40.0 * k, shared_clock=True) for k in range(4)]
    missing = [noise_like(s, s.log, 0.01) + 0.1 * s.modelled for s in scenes]
    assert strongest_lines([Signal(m[:, 0], RATE_HZ) for m in missing], 1.0, 3)
    assert list(EFFECT.grid(scenes, 0, missing)) == []


PERIOD_S = 5.0


def excited(seed: int, *, periods: float = 8.0) -> Scene:
    """Periodic excitation as identification asks for it, faded in and out."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(periods * PERIOD_S * RATE_HZ)) / RATE_HZ
    harmonics = np.arange(1, 5)
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(2, 4))
    waves = np.cos(2.0 * np.pi * harmonics / PERIOD_S * t[:, None, None] + phase)
    fade = np.clip(np.minimum(t, t[-1] - t), 0.0, 1.0)
    q = 0.2 * fade[:, None] * waves.sum(axis=2)
    scene = scene_of(q, log=seed, start=100.0 * seed, shared_clock=True)
    return replace(scene, encoder=q)


def reversing(scene: Scene, residual: Array) -> Array:
    """Add what a law of the joint that is missing makes: it jumps at each reversal."""
    return residual + 10.0 * np.tanh(scene.motion.dq / 0.02)


def test_what_repeats_with_the_motion_is_no_disturbance() -> None:
    """Lines far above the harmonics of the motion, larger than those of the model."""
    scenes = [excited(seed) for seed in range(2)]
    missing = [reversing(s, noise_like(s, s.log, 0.01)) for s in scenes]
    assert strongest_lines([Signal(m[:, 0], RATE_HZ) for m in missing], 1.0, 3)
    assert list(EFFECT.grid(scenes, 0, missing)) == []


def test_a_line_between_the_multiples_is_found_beside_them() -> None:
    scenes = [excited(seed) for seed in range(2)]
    frequency = 62.3 / PERIOD_S
    torque = [reversing(s, line(s, frequency)) for s in scenes]
    (settings,) = EFFECT.grid(scenes, 0, torque)
    assert settings["frequency"] == pytest.approx(frequency, abs=1e-3)


def test_the_period_of_a_motion() -> None:
    scene = excited(0)
    for joint in range(2):
        assert joint_period_s(scene, joint) == pytest.approx(PERIOD_S, abs=2e-3)
    assert not np.isfinite(joint_period_s(scene_of(wander(20.0)), 0))
    too_short = excited(0, periods=1.8)
    assert not np.isfinite(joint_period_s(too_short, 0))
    still = scene_of(wander(20.0, still=[0]))
    assert not np.isfinite(joint_period_s(still, 0))
