"""Every effect of the catalogue keeps the same promises."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.effects.effect import FROM_LOG, Columns, Effect, Settings
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.effects.scenes import (
    RATE_HZ,
    scene_of,
    scenes_of_logs,
    settings_of,
    wander,
)

CONTRACT = {
    *("stribeck", "asymmetric_friction", "load_dependent_friction", "gear_efficiency"),
    *(
        "thermal_friction",
        "quadratic_drag",
        "nonlinear_viscous",
        "presliding_hysteresis",
    ),
    *("torque_ripple", "joint_elasticity", "backlash", "transmission_coupling"),
    *("encoder_eccentricity", "spring", "payload", "base_tilt", "rotor_inertia"),
    *(
        "torque_constant",
        "torque_saturation",
        "torque_bias",
        "time_skew",
        "actuator_lag",
    ),
    *("periodic_disturbance", "drift", "external_contact"),
}
ADDED = {
    *("friction_change", "position_dependent_friction"),
    *("hysteresis", "joint_zero", "torque_filter"),
}
UNIT = re.compile(r"^(1|%|[A-Za-z0-9^./ ()-]+)$")


@pytest.fixture(params=sorted(CATALOGUE), scope="module")
def effect(request: pytest.FixtureRequest) -> Effect:
    return CATALOGUE[str(request.param)]


@pytest.fixture(scope="module")
def logs() -> list[Scene]:
    """Logs on a shared clock, with temperature, both joints moving and resting."""
    return scenes_of_logs()


Grids = Mapping[int | None, list[Settings]]


@pytest.fixture(scope="module")
def grids(effect: Effect, logs: list[Scene]) -> Grids:
    """The grid of each joint, which the tests of an effect share."""
    joints = [None] if effect.arm else [0, 1, None] if effect.shared else [0, 1]
    available = [joint for joint in joints if effect.available(logs, joint)]
    return {joint: settings_of(effect, logs, joint) for joint in available}


def points(grids: Grids) -> Iterator[tuple[int | None, Settings]]:
    """Yield joints with the first, middle and last point of their grids."""
    for joint, grid in grids.items():
        for k in sorted({0, len(grid) // 2, len(grid) - 1} if grid else ()):
            yield joint, grid[k]


def assert_sound(
    effect: Effect, scene: Scene, settings: Settings, columns: Columns
) -> None:
    count = len(effect.coefficients(settings))
    assert columns
    assert set(columns) <= set(range(scene.robot.n))
    for values in columns.values():
        assert values.shape == (scene.samples, count)
        assert values.dtype == np.float64
        assert np.all(np.isfinite(values))


def test_names_are_known() -> None:
    """Scripts of other people read these names."""
    assert all(name == effect.name for name, effect in CATALOGUE.items())
    assert set(CATALOGUE) == CONTRACT | ADDED


def test_parameters_have_names_units_and_bounds(effect: Effect, grids: Grids) -> None:
    """Also at every grid point, since coefficients may depend on the settings."""
    for _, settings in points(grids):
        coefficients = effect.coefficients(settings)
        assert coefficients
        specs = [*effect.settings, *coefficients]
        assert all(UNIT.match(spec.unit) and spec.low < spec.high for spec in specs)
        assert all(spec.low <= 0.0 <= spec.high for spec in coefficients)
        assert all(spec.low > 0.0 for spec in effect.settings if spec.logarithmic)
        names = [spec.name for spec in specs]
        assert len(set(names)) == len(names)
        assert all(re.fullmatch(r"[a-z][a-zA-Z0-9_]*", name) for name in names)


def test_the_grid_names_all_settings_within_bounds(
    effect: Effect, grids: Grids
) -> None:
    required = {setting.name for setting in effect.settings if setting.asked}
    by_name = {setting.name: setting for setting in effect.settings}
    for grid in grids.values():
        assert len({tuple(sorted(point.items())) for point in grid}) == len(grid) <= 200
        for point in grid:
            assert required <= set(point) <= set(by_name)
            assert all(
                by_name[name].low <= x <= by_name[name].high
                for name, x in point.items()
            )


def test_columns_are_sound(effect: Effect, logs: list[Scene], grids: Grids) -> None:
    """Also where a joint never moves, and without drive data in the robot file."""
    q = wander(12.0, seed=9, still=(1,), rests=((0.0, 2.0), (6.0, 8.0)))
    dull = scene_of(q, temperature=np.full(q.shape, 30.0))
    bare = replace(dull, robot=two_joint_robot(drives=False))
    for joint, settings in points(grids):
        for scene in (*logs, dull, *[bare] * effect.available([bare], joint)):
            columns = effect.columns(scene, joint, settings)
            assert_sound(effect, scene, settings, columns)
            assert joint is None or joint in columns


def test_sharpened_settings_keep_the_rules(
    effect: Effect, logs: list[Scene], grids: Grids
) -> None:
    """They name all settings within bounds, do not depend on what they were, and take
    any size.
    """
    for joint, settings in points(grids):
        count = len(effect.coefficients(settings))
        for size in (0.0, 1e-3, -1e-3, 1e6, -1e6):
            nearer = effect.sharpened(settings, np.full(count, size))
            if nearer is None:
                continue
            names = {setting.name for setting in effect.settings}
            assert set(nearer) == names - {FROM_LOG}
            for setting in effect.settings:
                if setting.name in nearer:
                    assert setting.low <= nearer[setting.name] <= setting.high
            assert effect.sharpened(nearer, np.full(count, size)) == nearer
            assert_sound(
                effect, logs[0], nearer, effect.columns(logs[0], joint, nearer)
            )


def cut(scene: Scene, first: int) -> Scene:
    """Leave off the first samples; the clock runs on."""
    motion = scene.motion
    begun = float(scene.motion.t[first])
    series = ("q", "dq", "ddq", "tau", "moving", "usable", "valid")
    late = {name: getattr(motion, name)[first:] for name in series}
    motion = replace(motion, **late, t=motion.t[first:] - begun)
    warm = scene.temperature[first:]
    return replace(scene, motion=motion, start=scene.start + begun, temperature=warm)


def test_the_past_is_forgotten(effect: Effect, logs: list[Scene], grids: Grids) -> None:
    """A log that begins later gives the same columns, once any state has settled."""
    scene = logs[0]
    first = round(8 * RATE_HZ)
    settle = round(6 * RATE_HZ)
    late = cut(scene, first)
    for joint, settings in points(grids):
        of_all = effect.columns(scene, joint, settings)
        of_late = effect.columns(late, joint, settings)
        for j, values in of_all.items():
            wanted = values[first + settle :]
            scale = np.max(np.abs(wanted), initial=1e-12)
            np.testing.assert_allclose(of_late[j][settle:], wanted, atol=1e-3 * scale)


def test_values_are_finite_and_in_the_joints_units(
    effect: Effect, logs: list[Scene], grids: Grids
) -> None:
    """Torques of a slide are forces."""
    slide = two_joint_robot(prismatic=True)
    for joint, settings in points(grids):
        count = len(effect.coefficients(settings))
        c = np.linspace(0.1, 0.2, count)
        covariance = 1e-4 * np.eye(count)
        for robot in (logs[0].robot, slide):
            values = effect.values(robot, joint, settings, c, covariance)
            assert values
            assert np.isfinite(
                [(value.value, value.std_error) for value in values]
            ).all()
            assert all(value.std_error >= 0.0 for value in values)
            force = robot is slide and joint == 1
            assert not force or all("N m" not in value.unit for value in values)


def test_plausibility_is_decided(
    effect: Effect, logs: list[Scene], grids: Grids
) -> None:
    """Nothing at all is within bounds that hold zero; what is beyond them is not."""
    for joint, settings in points(grids):
        specs = effect.coefficients(settings)
        assert effect.plausible(logs, joint, settings, np.zeros(len(specs))) in {
            True,
            False,
        }
        for k, spec in enumerate(specs):
            for bound, beyond in ((spec.low, -1.0), (spec.high, 1.0)):
                if np.isfinite(bound):
                    c = np.zeros(len(specs))
                    c[k] = bound + beyond
                    assert not effect.plausible(logs, joint, settings, c)
