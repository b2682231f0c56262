"""A smaller finding beside a larger one: another effect, or what the file has wrong."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from seqid_cli.discover.select.naming import named, steadiness
from seqid_cli.discover.select.seconds import share_not_understood
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.robot.base_parameters import base_regressor, free_basis
from tests import Array
from tests.unit.discover.arms import Extra, arm_scenes, at_joint, file_of, selected

LOSS = 0.05  # N m of friction per N m of load
STIFFNESS = 4.0  # N m/rad
MOMENT = 3.0  # kg m, by which gravity is off: 3000 of the file's errors
EFFECTS = ("load_dependent_friction", "spring")


def losses(scene: Scene) -> Array:
    """Torque (N,) of a gear that rubs with its load."""
    return np.asarray(LOSS * np.abs(scene.load[:, 0]) * scene.sign[:, 0])


def sprung(scene: Scene) -> Array:
    """Losses, and a spring beside them."""
    X = CATALOGUE["spring"].columns(scene, 0, {"cubic": 0.0})
    return losses(scene) + X[0] @ np.array([STIFFNESS, 1.0])


def heavier(scene: Scene) -> Array:
    """Losses, and gravity of which the file has another value."""
    basis, q = free_basis(scene.robot), scene.motion.q
    number = next(k for k, name in enumerate(basis.names) if name.startswith("mx_1"))
    H = base_regressor(scene.robot, basis, q, 0.0 * q, 0.0 * q)
    return losses(scene) + MOMENT * np.asarray(H[:, 0, number])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("torque", "names"),
    [(sprung, {"load_dependent_friction", "spring"}), (heavier, {EFFECTS[0]})],
)
def test_a_second_finding_is_none_where_a_loose_base_takes_it_up(
    torque: Extra, names: set[str]
) -> None:
    scenes = arm_scenes(at_joint(0, torque), noise=(0.1, 0.1))
    found = selected(scenes, EFFECTS, stages=file_of(scenes[0]))
    assert {taken.term.name for taken in found.terms} == names


@dataclass(frozen=True)
class Found:
    """What a finding is judged by here: where it is, what it gains, whether it is a
    smooth function.
    """

    channels: frozenset[int]
    total: float
    smooth: bool

    what: object = None  # no effect that is finer than smooth functions
    change: bool = False  # of the file's values

    @property
    def term(self) -> "Found":
        return self

    scored = score = term


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (Found(frozenset({0}), 300.0, smooth=True), 0.75),
        (Found(frozenset({0}), 90.0, smooth=True), 0.0),  # smaller
        (Found(frozenset({1}), 300.0, smooth=True), 0.0),  # elsewhere
        (Found(frozenset({0}), 300.0, smooth=False), 0.0),  # understood
    ],
)
def test_what_is_not_understood_is_the_larger_functions(
    function: Found, expected: float
) -> None:
    finding = Found(frozenset({0}), 100.0, smooth=False)
    results = {finding.term: finding, function.term: function}
    assert share_not_understood(finding, results) == expected


def function_of(quantity: str) -> Found:
    """A function of the joint's direction, and of how something goes on."""
    function = SmoothFunction(
        joint=0,
        quantities=(quantity, "direction"),
        label=f"{quantity} x direction",
        axes=(),
        factor="direction",
        mixing=np.eye(1),
    )
    return Found(frozenset({0}), 300.0, smooth=True, what=function)


@pytest.mark.parametrize(
    ("quantity", "is_change", "expected"),
    [("time", True, 0.0), ("time", False, 0.75), ("load", True, 0.75)],
)
def test_a_change_is_no_part_of_its_own_course(
    quantity: str, is_change: bool, expected: float
) -> None:
    """A warm gear's friction has changed, and goes on changing while the logs last."""
    function = function_of(quantity)
    finding = Found(frozenset({0}), 100.0, smooth=False, change=is_change)
    results = {finding.term: finding, function.term: function}
    assert share_not_understood(finding, results) == expected


def test_an_effect_beside_more_that_is_not_understood_is_less_sure() -> None:
    scenes = arm_scenes(at_joint(0, losses), logs=1, noise=(0.1, 0.1))
    (alone,) = selected(scenes, EFFECTS[:1], stages=file_of(scenes[0])).terms
    beside_more = replace(alone, not_understood=0.8)
    assert named(beside_more).confidence == pytest.approx(0.6 * named(alone).confidence)


def test_a_steady_effect_is_less_sure_beside_much_that_is_left() -> None:
    """A lag took 63 % of what a play had left, in every block alike."""
    steady = -1e3
    assert steadiness(steady, 0.63, 1.0) == 1.0
    assert steadiness(steady, 0.63, 2.5) == 1.0  # a right model may leave as much
    assert 0.7 < steadiness(steady, 0.63, 11.0) < 0.8
    assert steadiness(steady, 0.99, 11.0) > 0.96  # it explains what there was


def test_what_varies_is_not_doubted_twice() -> None:
    varies = 1e3
    left = np.sqrt(1.0 - 0.63) * (1.0 - 1.0 / 11.0)
    assert steadiness(varies, 0.63, 11.0) == pytest.approx(1.0 - 0.5 * left)
