"""Smooth terms: their bases, what they hold at the ends, and the way into a file and back."""

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.smooth import Axis, SmoothTerm, greville, splines
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.model.effects.scenes import scene_of, wander

KNOTS = (-1.0, -0.3, 0.1, 0.4, 1.2)


def test_splines_sum_to_one_and_reproduce_a_line() -> None:
    x = np.linspace(KNOTS[0], KNOTS[-1], 57)
    basis = splines(x, KNOTS)
    assert basis.shape == (57, Axis("position", 0, KNOTS).size)
    np.testing.assert_allclose(basis.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(basis @ greville(KNOTS), x, atol=1e-12)


def a_term() -> SmoothTerm:
    axes = (Axis("position", 1, KNOTS), Axis("velocity", 0, (-2.0, 0.0, 1.0)))
    c = np.random.default_rng(3).normal(size=axes[0].size * axes[1].size)
    return SmoothTerm(1, ("position", "other_joint:joint_1"), axes, "direction", c)


def test_a_term_survives_the_file() -> None:
    scene, robot = scene_of(wander(4.0, rests=())), two_joint_robot()
    term = a_term()
    entry = term.to_stage(robot)
    back = SmoothTerm.from_stage(entry, robot)
    assert (back.joint, back.quantities, back.axes, back.factor) == (
        term.joint,
        term.quantities,
        term.axes,
        term.factor,
    )
    np.testing.assert_array_equal(back.torque(scene), term.torque(scene))
    assert {p.unit for p in entry.parameters} == {"N m"}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("axis_1", "mood"),
        ("axis_1_joint", "wing"),
        ("axis_1_knot_0", 7.0),
        ("axis_1_knot_2", float("inf")),
        ("axis_1_knot_1", "x"),
        ("factor", "luck"),
    ],
)
def test_a_damaged_entry_is_named(key: str, value: str | float) -> None:
    robot = two_joint_robot()
    entry = a_term().to_stage(robot)
    entry.settings[key] = value
    with pytest.raises(ConfigError, match=r"axis_1|factor"):
        SmoothTerm.from_stage(entry, robot)


def test_missing_coefficients_are_counted() -> None:
    robot = two_joint_robot()
    entry = a_term().to_stage(robot)
    entry.parameters.pop()
    with pytest.raises(ConfigError, match="expected 35"):
        SmoothTerm.from_stage(entry, robot)
