"""Rows of the drive alone, where a torque sensor tells what the link takes."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.candidates import drive_rows
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import arm_scenes, ground_of, measuring, selected

LOSS = 0.05  # N m of friction per N m of load
HANG = 3.0  # N m, of what hangs on the link
NOISE = 0.02  # N m per sample, of the sensor
SOME = (
    "load_dependent_friction",
    "torque_saturation",
    "spring",
    "stribeck",
    "quadratic_drag",
)


def hang(scene: Scene) -> Array:
    """Cables that pull at the second link by a law that the catalogue does not have."""
    q = scene.motion.q
    return np.outer(HANG * np.sin(5.0 * q[:, 1]) * np.cos(2.0 * q[:, 0]), [0.0, 1.0])


def sensed(hung: float, loss: float, *, sensor: bool = True) -> list[Scene]:
    """Logs of the arm with a sensor behind each gear, and losses of the second one."""
    rng, scenes = np.random.default_rng(5), []
    for scene in arm_scenes():
        load = scene.modelled_load + hung * hang(scene)
        lost = loss * np.abs(load) * scene.sign * [0.0, 1.0]
        whole = measuring(scene, scene.measured + hung * hang(scene) + lost)
        read = load + NOISE * rng.normal(size=load.shape)
        scenes.append(
            replace(whole, sensor=scene.motion.filtered(read)) if sensor else whole
        )
    return scenes


def loss_of(scenes: list[Scene]) -> tuple[float, float]:
    """Loss that is told of the second joint, and its standard error."""
    told = selected(scenes, SOME)
    one = next(t for t in told.effects if t.term.key == ("load_dependent_friction", 1))
    error = np.sqrt(told.model.covariance(one.term)[0, 0])
    return float(told.model.coefficients(one.term)[0]), float(error)


def test_there_are_rows_only_where_every_log_has_the_sensors_reading() -> None:
    with_it = sensed(0.0, 0.0)
    one_without = [replace(with_it[0], sensor=None), *with_it[1:]]
    part = [
        replace(one, sensor=np.where([True, False], np.nan, one.sensor))
        for one in with_it
    ]
    for scenes, expected in ((with_it, [1, 1]), (one_without, [0, 0]), (part, [0, 1])):
        rows = drive_rows(rows_of(scenes))
        assert [rows.of(0), rows.of(1)] == expected


def test_what_acts_on_the_link_is_not_in_them() -> None:
    bare, hung = (drive_rows(rows_of(sensed(x, 0.0))).y[1] for x in (0.0, 1.0))
    whole = ground_of(sensed(1.0, 0.0)).base.y[1]
    assert np.max(np.abs(hung - bare)) < 1e-4 * HANG
    assert np.sqrt(np.mean(whole**2)) > 10.0 * np.sqrt(np.mean(hung**2))


@pytest.mark.slow
def test_a_loss_is_sharp_beside_a_link_that_the_model_does_not_know() -> None:
    value, error = loss_of(sensed(1.0, LOSS))
    _, without = loss_of(sensed(1.0, LOSS, sensor=False))
    assert abs(value - LOSS) < 4.0 * error
    assert error < 0.2 * without


@pytest.mark.parametrize("hung", [0.0, 1.0])
def test_a_drive_that_lacks_nothing_has_no_finding(hung: float) -> None:
    drives = {
        "load_dependent_friction",
        "torque_saturation",
        "stribeck",
        "quadratic_drag",
    }
    assert (
        not {one.term.name for one in selected(sensed(hung, 0.0), SOME).effects}
        & drives
    )
