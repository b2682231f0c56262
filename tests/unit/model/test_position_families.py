"""What every family of functions over position promises, a new one too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.check import check_consistency
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import FrictionJoint, FrictionStage
from seqid_cli.position_families import FAMILIES, PositionFamily, family_named
from tests import Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.small import NAMES_GANTRY, urdf_gantry
from tests.unit.export.arms import made
from tests.unit.export.test_code import check_torques

LOW, HIGH = -1.5, 2.5
ORDERS = range(6)


@pytest.fixture(params=FAMILIES, ids=lambda family: family.name)
def family(request: pytest.FixtureRequest) -> type[PositionFamily]:
    return request.param


def everywhere(functions: PositionFamily, count: int = 4001) -> Array:
    """Positions in the middle of equal parts of all that is identified."""
    return functions.at((np.arange(count) + 0.5) / count)


def test_names_and_flags_are_of_one_family_each() -> None:
    names = [family.name for family in FAMILIES]
    assert len(set(names)) == len(names)
    assert [family_named(name) for name in names] == list(FAMILIES)
    assert family_named("splines") is None
    flags = [family.python_flag for family in FAMILIES]
    assert len(set(flags)) == len(flags)
    assert flags.count("") == 1
    assert FAMILIES[0].is_tried(0.0, 0.1)  # the first serves any joint


@pytest.mark.parametrize("order", ORDERS)
def test_functions_are_counted_by_orders_and_the_first_is_one(
    family: type[PositionFamily], order: int
) -> None:
    functions = family(LOW, HIGH)
    q = everywhere(functions)
    size = family.size(order)
    values = functions.values(q, order)
    assert family.order(size) == order
    assert values.shape == (len(q), size)
    assert np.array_equal(values[:, 0], np.ones(len(q)))
    assert len(family.degrees(order)) == size
    # Fewer functions are the first of more.
    assert np.array_equal(functions.values(q, order + 1)[:, :size], values)
    np.testing.assert_allclose(family.mean(order), values.mean(axis=0), atol=1e-5)


def test_all_is_known_where_it_was_identified(family: type[PositionFamily]) -> None:
    functions = family(LOW, HIGH)
    q = everywhere(functions, 101)
    assert not functions.novelty(q).any()
    assert not functions.outside(q).any()
    np.testing.assert_allclose(functions.at(functions.share(q)), q, atol=1e-12)


def test_functions_go_on_without_a_step(family: type[PositionFamily]) -> None:
    functions = family(LOW, HIGH)
    q = np.linspace(LOW - 3.0, HIGH + 3.0, 20001)
    steps = np.abs(np.diff(functions.values(q, 5), axis=0))
    assert steps.max() < 40.0 * (q[1] - q[0])
    below, above = functions.known_range()
    assert np.array_equal(functions.novelty(q).any(axis=1), (q < below) | (q > above))


def joint_of(family: type[PositionFamily], seed: int, **fields: Any) -> FrictionJoint:
    order = 2
    entries = 0.2 * np.random.default_rng(seed).normal(size=(family.size(order), 3))
    entries[0, 0] = 2.0
    described = {"position_order": order, "position_basis": family.name} | fields
    joint = friction_joint(
        entries, position_range=[LOW, HIGH], speed_range=[0.1, 2.0], sign_width=0.01
    )
    for name, value in described.items():
        setattr(joint, name, value)
    return joint


def test_files_and_exported_code_know_it(
    family: type[PositionFamily], tmp_path: Path
) -> None:
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 8, known=True)
    joints = {
        name: joint_of(family, seed) for seed, name in enumerate(robot.joint_names)
    }
    stages.friction = FrictionStage(joints=joints, verdicts=[], notes=[])
    for joint in joints.values():
        assert FrictionSurface.from_stage(joint).scaling.family is family
    check_consistency(
        with_stage(None, robot_id(robot), [], friction=stages.friction), "here"
    )
    check_torques((robot, stages), tmp_path)


def test_a_file_of_another_family_or_size_is_refused(
    family: type[PositionFamily],
) -> None:
    def check(joint: FrictionJoint) -> None:
        stage = FrictionStage(joints={"a": joint}, verdicts=[], notes=[])
        file = with_stage(None, robot, [], friction=stage)
        check_consistency(file, "here")

    from seqid_cli.params.schema import RobotId

    robot = RobotId(name="arm", joints=["a"], sha256="0" * 64)
    with pytest.raises(ConfigError, match="'splines', none of chebyshev, fourier"):
        check(joint_of(family, 0, position_basis="splines"))
    with pytest.raises(ConfigError, match="must have"):
        check(joint_of(family, 0, position_order=3))
