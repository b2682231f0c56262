"""Friction that changes: with the temperature of a heat balance, and by wear."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.effects.friction_change import FrictionChange
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.thermal_friction import ThermalFriction
from tests import Array
from tests.plants.robots.two_joint import torque_model
from tests.unit.effects.fitting import direction, fit, fitted, trial
from tests.unit.effects.scenes import scene_of, wander

# degC, J/K, W/K, W
AMBIENT = 22.0
CAPACITY = 600.0
LOSS = 2.0
POWER = 40.0
TIME_CONSTANT = CAPACITY / LOSS
# N m/K, N m s/(rad K)
COULOMB_SLOPE = 0.02
VISCOUS_SLOPE = -0.05
APART = 200.0
LOGS = 6
SECONDS = 12.0


def temperature(t: Array) -> Array:
    """Return the temperature [degC] of a gear that starts cold, by its heat balance."""
    return AMBIENT + POWER / LOSS * (1.0 - np.exp(-t / TIME_CONSTANT))


def law(t: Array, q: Array, dq: Array) -> Array:
    """Friction of both joints at the temperature of the moment."""
    warmer = (temperature(t) - AMBIENT)[:, None]
    coulomb = 2.0 + COULOMB_SLOPE * warmer
    viscous = 1.5 + VISCOUS_SLOPE * warmer
    return coulomb * direction(dq) + viscous * dq


@pytest.fixture(scope="module")
def trials() -> list[Scene]:
    """Logs minutes apart, the robot working on in between."""
    return [trial(law, seed=k, seconds=SECONDS, start=k * APART) for k in range(LOGS)]


def logged(scene: Scene) -> Scene:
    """Return the same log with a temperature channel of whole degrees."""
    degrees = np.round(temperature(scene.time))
    return replace(scene, temperature=np.stack([degrees, degrees], axis=1))


def test_slopes_come_back_from_logged_temperature(trials: list[Scene]) -> None:
    settings, c = fit(ThermalFriction(), [logged(each) for each in trials], joint=0)
    assert settings["logged"] == 1.0
    assert AMBIENT < settings["reference_temperature"] < AMBIENT + POWER / LOSS
    assert c == pytest.approx([COULOMB_SLOPE, VISCOUS_SLOPE], rel=0.1)


def test_a_change_is_counted_from_the_temperature_of_the_file(
    trials: list[Scene],
) -> None:
    """Friction was identified at 12 degC: even logs of one temperature are warmer than
    that.
    """
    scene = logged(trials[-1])
    warm = replace(scene, temperature=np.full((scene.samples, 2), 52.0))
    surfaces = tuple(
        replace(surface, temperature=12.0) for surface in scene.model.surfaces
    )
    identified = replace(warm, model=replace(scene.model, surfaces=surfaces))
    effect = ThermalFriction()
    assert {point["logged"] for point in effect.grid([warm], 0, [])} <= {0.0}
    (point,) = effect.grid([identified], 0, [])
    assert point["reference_temperature"] == 12.0
    columns = effect.columns(identified, 0, point)[0]
    np.testing.assert_allclose(columns[:, 1], 40.0 * scene.motion.dq[:, 0])
    assert effect.searched(point) == 0
    assert effect.searched({**point, "logged": 0.0}) == 1


def test_the_time_constant_comes_back_from_the_clock(trials: list[Scene]) -> None:
    """Cold friction less warm friction, and how fast it goes."""
    settings, c = fit(ThermalFriction(), trials, joint=1)
    rise = POWER / LOSS
    assert settings["logged"] == 0.0
    assert settings["warm_up_time"] == pytest.approx(TIME_CONSTANT, rel=0.05)
    assert c == pytest.approx([-COULOMB_SLOPE * rise, -VISCOUS_SLOPE * rise], rel=0.1)


def times(scenes: list[Scene]) -> list[float]:
    """Return the time constants that are tried, s."""
    return [point["warm_up_time"] for point in ThermalFriction().grid(scenes, 0, [])]


def test_a_warm_up_longer_than_the_log_is_not_tried() -> None:
    """A log of 30 s tells no time constant: several of them must go by, and none is
    shorter than a minute.
    """
    effect = ThermalFriction()
    short = [scene_of(wander(30.0))]
    assert times(short) == []
    settings = {"warm_up_time": 70.0, "logged": 0.0, "reference_temperature": 0.0}
    assert not effect.plausible(short, 0, settings, np.ones(2))

    long = [scene_of(wander(240.0))]
    assert min(times(long)) >= 60.0
    assert 79.0 < max(times(long)) <= 80.0
    assert effect.plausible(long, 0, settings, np.ones(2))
    for seconds in (90.0, 30.0):
        other = {**settings, "warm_up_time": seconds}
        assert not effect.plausible(long, 0, other, np.ones(2))


def test_a_temperature_that_stays_leaves_no_warm_up(trials: list[Scene]) -> None:
    """Nothing warms up by the clock while the logged temperature stays the same."""
    steady = [
        replace(scene, temperature=np.full((scene.samples, 2), 31.0))
        for scene in trials
    ]
    assert times(trials)
    assert times(steady) == []


def test_logs_on_one_clock_cover_a_warm_up_together(trials: list[Scene]) -> None:
    assert all(scene.shared_clock for scene in trials)
    span = (LOGS - 1) * APART + SECONDS
    assert max(times(trials)) == pytest.approx(span, rel=0.01)
    apart = [replace(scene, start=0.0, shared_clock=False) for scene in trials]
    assert times(apart) == []


def test_a_logged_temperature_needs_no_time(trials: list[Scene]) -> None:
    effect = ThermalFriction()
    warm = logged(trials[-1])
    surfaces = tuple(
        replace(surface, temperature=12.0) for surface in warm.model.surfaces
    )
    identified = replace(warm, model=replace(warm.model, surfaces=surfaces))
    (point,) = effect.grid([identified], 0, [])
    assert point["logged"] == 1.0
    assert effect.plausible([identified], 0, {**point, "warm_up_time": 1e4}, np.ones(2))


def test_damaged_temperature_is_not_used(trials: list[Scene]) -> None:
    """Not numbers, or not degrees Celsius."""
    effect = ThermalFriction()
    hot = {"warm_up_time": 100.0, "logged": 1.0}
    for bad in (np.nan, np.inf, 4000.0):
        scenes = [logged(each) for each in trials]
        scenes[0].temperature[7, 0] = bad
        assert {point["logged"] for point in effect.grid(scenes, 0, [])} == {0.0}
        columns = effect.columns(scenes[0], 0, {**hot, "reference_temperature": 25.0})
        assert np.all(np.isfinite(columns[0]))


def test_what_no_channel_tells_cannot_be_ruled_out() -> None:
    """Where file and logs know the temperature, and it is the same, it can."""
    short = scene_of(wander(10.0))
    logged_alone = replace(short, temperature=np.full((short.samples, 2), AMBIENT))
    surfaces = [
        replace(surface, temperature=AMBIENT) for surface in short.model.surfaces
    ]
    same = replace(logged_alone, model=replace(logged_alone.model, surfaces=surfaces))
    possible = [
        ThermalFriction().possible([scene], 0) for scene in (short, logged_alone, same)
    ]
    assert possible == [True, True, False]


WORN = np.array([0.8, -0.3])  # Coulomb N m, viscous N m s/rad, both joints


def worn(t: Array, q: Array, dq: Array) -> Array:
    return WORN[0] * direction(dq) + WORN[1] * dq


@pytest.mark.parametrize("joint", [0, 1])
def test_the_change_comes_back(joint: int) -> None:
    effect = FrictionChange()
    scenes = [trial(worn, noise=0.2)]
    c, _ = fitted(effect, scenes, joint, {})
    assert effect.change
    assert c == pytest.approx(WORN, rel=0.1)
    assert effect.plausible(scenes, joint, {}, c)


def test_friction_that_nobody_knew_has_not_changed() -> None:
    scene = scene_of(wander(10.0))
    model = torque_model(scene.robot)
    half = scene_of(
        wander(10.0), model=replace(model, surfaces=[model.surfaces[0], None])
    )
    assert FrictionChange().available([scene, half], 0)
    assert not FrictionChange().available([scene, half], 1)
