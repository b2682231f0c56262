"""Every effect of the catalogue keeps the same promises."""

import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from seqid_cli.model.effects.effect import Columns, Effect, Family, Settings
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.model.effects.scenes import RATE_HZ, scene_of, scenes_of_logs, settings_of, wander

CONTRACT = {
    *("stribeck", "asymmetric_friction", "load_dependent_friction", "gear_efficiency"),
    *("thermal_friction", "quadratic_drag", "nonlinear_viscous", "presliding_hysteresis"),
    *("torque_ripple", "joint_elasticity", "backlash", "transmission_coupling"),
    *("encoder_eccentricity", "spring", "payload", "base_tilt", "rotor_inertia"),
    *("torque_constant", "torque_saturation", "torque_bias", "time_skew", "actuator_lag"),
    *("periodic_disturbance", "drift", "external_contact"),
}
ADDED = {"friction_change", "position_dependent_friction"}
ELEMENTARY = {"torque_bias", "drift", "time_skew", "periodic_disturbance"}  # what their names say
WITHOUT_TORQUE = {"external_contact"}

UNIT = re.compile(r"^(1|%|[A-Za-z0-9^./ ()-]+)$")


@pytest.fixture(params=sorted(CATALOGUE))
def effect(request: pytest.FixtureRequest) -> Effect:
    return CATALOGUE[str(request.param)]


@pytest.fixture(scope="module")
def logs() -> list[Scene]:
    """Logs on a shared clock, with temperature, both joints moving and resting."""
    return scenes_of_logs()


def joints_of(effect: Effect) -> list[int | None]:
    if effect.arm:
        return [None]
    return [0, 1, None] if effect.shared else [0, 1]


def points(effect: Effect, scenes: list[Scene]) -> Iterator[tuple[int | None, Settings]]:
    """Yield joints with the first, middle and last point of their grids."""
    for joint in joints_of(effect):
        if effect.available(scenes, joint):
            grid = settings_of(effect, scenes, joint)
            for k in sorted({0, len(grid) // 2, len(grid) - 1} if grid else ()):
                yield joint, grid[k]


def assert_sound(effect: Effect, scene: Scene, settings: Settings, columns: Columns) -> None:
    count = len(effect.coefficients(settings))
    assert columns
    assert set(columns) <= set(range(scene.robot.n))
    for values in columns.values():
        assert values.shape == (scene.samples, count)
        assert values.dtype == np.float64
        assert np.all(np.isfinite(values))


def test_names_are_unique_and_known() -> None:
    """What other people's scripts read."""
    assert all(name == effect.name for name, effect in CATALOGUE.items())
    assert set(CATALOGUE) <= CONTRACT | ADDED
    assert not CONTRACT & ADDED


def test_the_file_has_the_effects_name(effect: Effect) -> None:
    assert Path(inspect.getfile(type(effect))).stem == effect.name


def test_the_module_says_what_it_is(effect: Effect) -> None:
    """An equation on its own line, and where it comes from unless it is a definition."""
    doc = sys.modules[type(effect).__module__].__doc__ or ""
    if effect.name not in WITHOUT_TORQUE:
        assert re.search(r"^    \S.* = ", doc, re.MULTILINE), "no equation"
    if effect.name not in ELEMENTARY:
        assert re.search(r"\b(19|20)\d\d\b", doc), "no reference with its year"


def test_family_and_advice(effect: Effect) -> None:
    assert effect.family in get_args(Family)
    assert len(effect.separate_by) > 40
    assert effect.passes in {1, 2}
    assert effect.name not in effect.alike
    assert set(effect.alike) <= CONTRACT | ADDED


def test_parameters_have_names_units_and_bounds(effect: Effect, logs: list[Scene]) -> None:
    """Also at every grid point, since coefficients may depend on the settings."""
    names = [setting.name for setting in effect.settings]
    for setting in effect.settings:
        assert UNIT.match(setting.unit)
        assert setting.low < setting.high
        assert not setting.logarithmic or setting.low > 0.0
    for _, settings in points(effect, logs):
        coefficients = effect.coefficients(settings)
        assert coefficients
        for coefficient in coefficients:
            assert UNIT.match(coefficient.unit)
            assert coefficient.low < coefficient.high
            assert coefficient.low <= 0.0 <= coefficient.high
        every = names + [coefficient.name for coefficient in coefficients]
        assert len(set(every)) == len(every)
        assert all(re.fullmatch(r"[a-z][a-zA-Z0-9_]*", name) for name in every)


def test_the_grid_names_all_settings_within_bounds(effect: Effect, logs: list[Scene]) -> None:
    for joint in joints_of(effect):
        if not effect.available(logs, joint):
            continue
        grid = settings_of(effect, logs, joint)
        assert len(grid) <= 200
        assert len({tuple(sorted(point.items())) for point in grid}) == len(grid)
        for point in grid:
            assert needed(effect) <= set(point) <= {s.name for s in effect.settings}
            for setting in (s for s in effect.settings if s.name in point):
                assert setting.low <= point[setting.name] <= setting.high


def test_columns_are_sound(effect: Effect, logs: list[Scene]) -> None:
    for joint, settings in points(effect, logs):
        for scene in logs:
            columns = effect.columns(scene, joint, settings)
            assert_sound(effect, scene, settings, columns)
            assert joint is None or joint in columns


def test_columns_are_sound_for_a_joint_that_never_moves(effect: Effect, logs: list[Scene]) -> None:
    """With settings found elsewhere, and without drive data in the robot file."""
    q = wander(12.0, seed=9, still=(1,), rests=((0.0, 2.0), (6.0, 8.0)))
    dull = scene_of(q, temperature=np.full(q.shape, 30.0))
    bare = replace(dull, robot=two_joint_robot(drives=False))
    for joint, settings in points(effect, logs):
        assert_sound(effect, dull, settings, effect.columns(dull, joint, settings))
        if effect.available([bare], joint):
            assert_sound(effect, bare, settings, effect.columns(bare, joint, settings))


def test_sharpened_settings_keep_the_rules(effect: Effect, logs: list[Scene]) -> None:
    """They name all settings within bounds, do not depend on what they were, and take any size."""
    for joint, settings in points(effect, logs):
        count = len(effect.coefficients(settings))
        for size in (0.0, 1e-3, -1e-3, 1e6, -1e6):
            nearer = effect.sharpened(settings, np.full(count, size))
            if nearer is None:
                continue
            assert set(nearer) == {setting.name for setting in effect.settings}
            for setting in effect.settings:
                assert setting.low <= nearer[setting.name] <= setting.high
            assert effect.sharpened(nearer, np.full(count, size)) == nearer
            for scene in logs[:1]:
                assert_sound(effect, scene, nearer, effect.columns(scene, joint, nearer))


def test_derivatives_by_continuous_settings_exist(effect: Effect, logs: list[Scene]) -> None:
    """Central differences of two step sizes agree: no jumps where the search runs."""
    scene = logs[0]
    for joint, settings in points(effect, logs):
        for setting in effect.between(settings):
            slopes = []
            for step in (1e-4, 5e-5):
                sides = [moved(settings, setting.name, side * step) for side in (1.0, -1.0)]
                above, below = (effect.columns(scene, joint, side) for side in sides)
                width = sides[0][setting.name] - sides[1][setting.name]
                slopes.append({j: (above[j] - below[j]) / width for j in above})
            for j, slope in slopes[0].items():
                assert np.all(np.isfinite(slope))
                scale = np.sqrt(np.mean(slope**2))
                gap = np.sqrt(np.mean((slope - slopes[1][j]) ** 2))
                assert gap <= 0.05 * scale + 1e-9


def needed(effect: Effect) -> set[str]:
    """Settings that every point of the grid has."""
    return {setting.name for setting in effect.settings if setting.asked}


def moved(settings: Settings, name: str, by: float) -> dict[str, float]:
    """Change one setting by a share of its size."""
    value = settings[name]
    return {**settings, name: value + by * (abs(value) if value else 1.0)}


def cut(scene: Scene, first: int) -> Scene:
    """Leave off the first samples; the clock runs on."""
    motion = scene.motion
    rows = slice(first, None)
    late = replace(
        motion,
        t=motion.t[rows] - motion.t[first],
        q=motion.q[rows],
        dq=motion.dq[rows],
        ddq=motion.ddq[rows],
        tau=None if motion.tau is None else motion.tau[rows],
        moving=motion.moving[rows],
        usable=motion.usable[rows],
        valid=motion.valid[rows],
    )
    heat = None if scene.temperature is None else scene.temperature[rows]
    start = scene.start + float(motion.t[first])
    return replace(scene, motion=late, start=start, temperature=heat)


def test_the_past_is_forgotten(effect: Effect, logs: list[Scene]) -> None:
    """A log that begins later gives the same columns, once any state has settled."""
    scene, first, settle = logs[0], round(8 * RATE_HZ), round(6 * RATE_HZ)
    late = cut(scene, first)
    for joint, settings in points(effect, logs):
        whole = effect.columns(scene, joint, settings)
        part = effect.columns(late, joint, settings)
        for j, values in whole.items():
            wanted = values[first + settle :]
            scale = np.max(np.abs(wanted), initial=1e-12)
            np.testing.assert_allclose(part[j][settle:], wanted, atol=1e-3 * scale)


def test_values_are_finite_and_in_the_joints_units(effect: Effect, logs: list[Scene]) -> None:
    """Torques of a slide are forces."""
    slide = two_joint_robot(prismatic=True)
    for joint, settings in points(effect, logs):
        count = len(effect.coefficients(settings))
        c, covariance = np.linspace(0.1, 0.2, count), 1e-4 * np.eye(count)
        for robot in (logs[0].robot, slide):
            values = effect.values(robot, joint, settings, c, covariance)
            assert values
            for value in values:
                assert np.isfinite(value.value)
                assert np.isfinite(value.std_error)
                assert value.std_error >= 0.0
                assert joint is None or robot is not slide or joint == 0 or "N m" not in value.unit


def test_plausibility_is_decided(effect: Effect, logs: list[Scene]) -> None:
    """Nothing at all is within bounds that hold zero; what is beyond them is not."""
    for joint, settings in points(effect, logs):
        specs = effect.coefficients(settings)
        assert effect.plausible(logs, joint, settings, np.zeros(len(specs))) in {True, False}
        for k, spec in enumerate(specs):
            for bound, beyond in ((spec.low, -1.0), (spec.high, 1.0)):
                if np.isfinite(bound):
                    c = np.zeros(len(specs))
                    c[k] = bound + beyond
                    assert not effect.plausible(logs, joint, settings, c)
