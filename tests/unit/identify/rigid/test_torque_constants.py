"""The error of a torque constant moves all that was identified, counts once, and
cancels again.
"""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.compare.differences import _torque_constants_held
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.model.bodies.nearest import identified
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.sample import Rig

ERROR = 0.02  # stated
STEP = 1e-3  # by which a joint's torque is scaled
# Given, so that they are not looked for: what is scaled moves alike with any orders.
ORDERS = FrictionOptions(position_order=4, velocity_order=3)


def stated(robot: Robot) -> Robot:
    first, *others = robot.joints
    return replace(robot, joints=(replace(first, torque_constant_error=ERROR), *others))


def scaled(logs: list[Recording], step: float) -> list[Recording]:
    """Logs whose torque of the first joint is another."""
    factor = 1.0 + step * (np.arange(logs[0].tau.shape[1]) == 0)
    return [replace(log, tau=log.tau * factor) for log in logs]


def identified_from(rig: Rig, robot: Robot, step: float) -> Stages:
    """All stages by the encoders, from logs whose torque of the first joint is
    scaled.
    """
    folders = ("friction", "gravity", "inertia")
    drills, slow, pairs = (scaled(rig.logs(name), step) for name in folders)
    stages = Stages(friction=identify_friction(drills, robot, options=ORDERS))
    result = identify_gravity(slow + drills, robot, stages)
    stages.gravity, stages.friction = result.gravity, result.friction
    options = InertiaOptions(source="encoder")
    stages.inertia = identify_inertia(pairs, robot, stages, options=options).inertia
    return stages


@pytest.fixture(scope="module")
def known(one_joint: Rig) -> list[Stages]:
    """Stages without a stated error, with one, and with one of scaled torque."""
    plain, robot = one_joint.robot, stated(one_joint.robot)
    given = ((plain, 0.0), (robot, 0.0), (robot, STEP))
    return [identified_from(one_joint, *each) for each in given]


def seen_and_told(before: RigidStage, after: RigidStage) -> tuple[Array, Array]:
    value = [[p.value for p in stage.parameters] for stage in (before, after)]
    told = np.array(before.torque_constant_moves["joint_1"]) * STEP / ERROR
    return np.subtract(value[1], value[0]), told


@pytest.mark.slow
def test_scaled_torque_moves_every_stage_as_told(known: list[Stages]) -> None:
    _, before, after = known
    surfaces = [
        stages.friction.joints["joint_1"].positive for stages in (before, after)
    ]
    np.testing.assert_allclose(
        surfaces[1], (1.0 + STEP) * np.array(surfaces[0]), rtol=1e-9
    )
    np.testing.assert_allclose(*seen_and_told(before.gravity, after.gravity), rtol=1e-6)
    # The rotor's torque enters by thinned samples, and the weights of the rows move a
    # little.
    seen, told = seen_and_told(before.inertia, after.inertia)
    np.testing.assert_allclose(seen, told, rtol=1e-3)
    # the rotor does not scale
    assert told[0] > 1.02 * STEP * before.inertia.parameters[0].value


@pytest.mark.slow
def test_what_is_held_against_the_same_torque_does_not_change(
    known: list[Stages],
) -> None:
    plain, with_error, _ = known
    for name in ("gravity", "inertia"):
        one, other = getattr(plain, name), getattr(with_error, name)
        assert one.torque_constant_moves == {}
        assert other.covariance == pytest.approx(np.array(one.covariance), rel=1e-9)
        assert [p.value for p in one.parameters] == [p.value for p in other.parameters]
        held = [p.std_error for p in _torque_constants_held(other)]
        assert held == pytest.approx([p.std_error for p in one.parameters], rel=1e-9)
        total = (
            np.diag(other.covariance)
            + np.array(other.torque_constant_moves["joint_1"]) ** 2
        )
        assert [p.std_error for p in other.parameters] == pytest.approx(
            np.sqrt(total), rel=1e-9
        )
    verdicts = [stages.friction.verdicts for stages in (plain, with_error)]
    assert verdicts[0] == verdicts[1]


@pytest.mark.slow
def test_export_counts_one_error_for_gravity_and_inertia(
    known: list[Stages], one_joint: Rig
) -> None:
    stages = known[1]
    demand = identified(stages, stated(one_joint.robot))
    np.testing.assert_allclose(
        np.sqrt(np.diag(demand.covariance)), demand.errors, rtol=1e-9
    )
    moves = [
        x.torque_constant_moves["joint_1"] for x in (stages.inertia, stages.gravity)
    ]
    first, second, *_ = np.concatenate(moves)
    assert demand.covariance[0, 1] == pytest.approx(first * second, rel=1e-9)


def test_the_simultaneous_way_tells_the_same(two_joint: Rig) -> None:
    logs = two_joint.logs("inertia")
    robot = stated(two_joint.robot)
    found = [
        identify_simultaneous(scaled(logs, step), robot, options=MotionOptions())
        for step in (0.0, STEP)
    ]
    (friction, before), (_, after) = found
    seen, told = seen_and_told(before, after)
    np.testing.assert_allclose(
        seen, told, rtol=0.02, atol=0.01 * float(np.abs(told).max())
    )
    joint = friction.joints["joint_1"]
    assert joint.torque_constant_error == ERROR
    assert joint.parameters[0].std_error > 0.9 * ERROR * joint.parameters[0].value
