"""Coefficients at a bound: a truth at the edge of what is physical has its name."""

from collections.abc import Callable

import numpy as np
import pytest

from seqid_cli.discover.select.bounds import within_bounds
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import (
    arm_scenes,
    at_joint,
    candidate,
    file_of,
    selected,
)

LOSS = 0.1  # N m of friction per N m of load, while the gear drives
RIVALS = (
    "gear_efficiency",
    "load_dependent_friction",
    "spring",
    "torque_saturation",
    "asymmetric_friction",
    "torque_bias",
)
GEAR = candidate("gear_efficiency", 0)
ONE_SIZE = np.eye(2)


def moved(
    c: list[float], std: float, share: float = 0.0, correlation: float = 0.0
) -> list[float]:
    covariance = std**2 * np.array([[1.0, correlation], [correlation, 1.0]])
    values = within_bounds(
        GEAR, np.array(c), covariance, ONE_SIZE, negligible_share=share
    )
    return values.tolist()


def test_what_is_within_its_bounds_stays() -> None:
    assert moved([0.1, 0.02], 0.01) == [0.1, 0.02]


def test_within_its_error_a_coefficient_is_at_the_bound() -> None:
    assert moved([0.1, -0.015], 0.01) == [0.1, 0.0]


def test_beyond_the_upper_bound_it_is_at_that_bound() -> None:
    high = GEAR.effect.coefficients(GEAR.settings)[0].high
    assert np.isfinite(high)
    assert moved([high + 0.015, 0.02], 0.01) == [high, 0.02]


def test_all_beyond_their_upper_bounds_are_at_them() -> None:
    high = [spec.high for spec in GEAR.effect.coefficients(GEAR.settings)]
    assert moved([bound + 0.015 for bound in high], 0.01) == high


def test_all_below_their_bounds_are_at_them() -> None:
    assert moved([-0.005, -0.005], 0.01) == [0.0, 0.0]


def test_a_variance_that_rounding_makes_negative_is_none() -> None:
    covariance = np.diag([1e-6, -1e-20])
    values = within_bounds(
        GEAR, np.array([0.1, -0.006]), covariance, ONE_SIZE, negligible_share=0.04
    )
    assert values.tolist() == [0.1, 0.0]


@pytest.mark.parametrize(
    ("beyond", "expected"),
    [([-0.0015, -0.005], [0.0, 0.0085]), ([-0.0005, -0.015], [0.00085, 0.0])],
    ids=["the better known", "the worse known"],
)
def test_the_one_that_is_furthest_beyond_in_its_errors_goes_first(
    beyond: list[float], expected: list[float]
) -> None:
    """At its bound, it takes the other one back within its bounds."""
    std = np.array([0.001, 0.01])
    correlation = np.array([[1.0, 0.9], [0.9, 1.0]])
    values = within_bounds(
        GEAR,
        np.array(beyond),
        correlation * np.outer(std, std),
        ONE_SIZE,
        negligible_share=0.0,
    )
    assert values == pytest.approx(expected)


def test_without_any_variance_it_is_at_the_bound_by_the_law_alone() -> None:
    assert moved([0.1, -0.006], 0.0, share=0.04) == [0.1, 0.0]


def test_beyond_its_error_it_stays_where_it_is() -> None:
    assert moved([0.1, -0.03], 0.01) == [0.1, -0.03]


def test_what_a_law_does_not_tell_is_an_error_as_well() -> None:
    assert moved([0.1, -0.006], 1e-6) == [0.1, -0.006]
    assert moved([0.1, -0.006], 1e-6, share=0.04) == [pytest.approx(0.1), 0.0]


def test_the_error_of_a_law_goes_by_the_largest_column_however_small() -> None:
    assert moved([0.1, -0.03], 1e-6, share=0.04) == [0.1, -0.03]


def test_the_error_of_a_law_is_a_torque_whatever_the_unit_of_a_column() -> None:
    """A column of ten times the torque is beyond by ten times as much."""
    covariance = 1e-12 * np.eye(2)
    sizes = np.diag([1.0, 100.0])
    nearer, further = (
        within_bounds(
            GEAR, np.array([0.1, c]), covariance, sizes, negligible_share=0.04
        )[1]
        for c in (-0.0006, -0.006)
    )
    assert nearer == 0.0
    assert further == pytest.approx(-0.006)


def test_the_others_are_what_they_are_at_the_bound() -> None:
    assert moved([0.1, -0.01], 0.01, correlation=0.5) == pytest.approx([0.105, 0.0])


def test_what_the_others_push_beyond_a_bound_is_at_that_bound() -> None:
    """An estimate that was within its bounds does not go back there."""
    assert moved([1.52, 0.005], 0.02, correlation=0.9)[1] == 0.0


def driving_alone(size: float) -> Callable[[Scene], Array]:
    """Losses of a gear that costs nothing while it is driven, or gives a little."""

    def torque(scene: Scene) -> Array:
        load = scene.load[:, 0]
        driven = load * scene.motion.dq[:, 0] < 0.0
        losses = np.where(driven, size, LOSS)
        return np.asarray(losses * np.abs(load) * scene.sign[:, 0])

    return torque


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "driven"), [(0, 0.0), (1, 0.0), (2, -0.001)])
def test_losses_only_when_driving_have_their_name(seed: int, driven: float) -> None:
    """The estimate of the other loss lies below zero in half of all logs."""
    extra = at_joint(0, driving_alone(driven))
    scenes = arm_scenes(extra, seed=seed, noise=(0.05, 0.05))
    found = selected(scenes, RIVALS, stages=file_of(scenes[0]))
    assert [taken.term.key for taken in found.terms] == [("gear_efficiency", 0)]
    term = found.terms[0].term
    losses = found.model.coefficients(term)
    assert term.what.effect.plausible(scenes, 0, term.what.settings, losses)


def test_a_spring_that_rests_turns_away_is_none() -> None:
    scenes = arm_scenes(seconds=8.0, logs=1)
    spring = CATALOGUE["spring"]
    settings = {"cubic": 0.0}
    assert spring.plausible(scenes, 0, settings, np.array([-5.0, 2.0]))
    assert spring.plausible(scenes, 0, settings, np.array([5.0, -25.0]))
    assert not spring.plausible(scenes, 0, settings, np.array([-0.2, 3.7]))
