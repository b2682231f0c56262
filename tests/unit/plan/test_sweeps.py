"""Plans of friction, IMUs, validation and whole sessions."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.motion.planned import sampled
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.sweeps import POSTURES, plan_friction, plan_imu
from tests.plants.planned import limits_used
from tests.plants.robots.sample import sample_robot

OPTIONS = PlanOptions(duration_s=24.0, move_s=6.0, pool=60, sweeps=1)
RATE_HZ = 500.0


def assert_within_limits(belief: Belief, move: PlannedMove) -> None:
    limits = belief.limits
    t, q, dq, _ = sampled(move, belief.robot.joint_names, RATE_HZ)
    assert np.all(
        limits_used(belief, move, RATE_HZ)[:3] <= [1 + 1e-9, 1 + 1e-3, 1 + 1e-2]
    )
    assert t[-1] == pytest.approx(move.duration_s, abs=0.02 * (1 + len(move.strokes)))
    still = [name not in move.joints for name in belief.robot.joint_names]
    assert not np.any(dq[:, still])
    assert np.abs(np.gradient(q, t, axis=0) - dq).max() < 0.05 * limits.speed.max()


@pytest.mark.slow
def test_friction_sweeps_every_joint_both_ways_over_its_range(belief: Belief) -> None:
    planned = plan_friction(belief, OPTIONS)
    assert [move.joints[0] for move in planned.moves] == list(belief.robot.joint_names)
    for j, move in enumerate(planned.moves):
        assert_within_limits(belief, move)
        assert len(move.strokes) == 2 * 10  # ten speeds per joint, both ways
        forward, backward = move.strokes[:2]
        assert (forward.start, forward.end) == (backward.end, backward.start)
        assert forward.start == belief.limits.lower[j]
        assert forward.end == belief.limits.upper[j]


def test_imus_see_the_first_joint_from_many_sides(belief: Belief) -> None:
    planned = plan_imu(belief, OPTIONS)
    first = [move for move in planned.moves if move.joints == ["shoulder_pan"]]
    assert len(first) == POSTURES
    assert len({tuple(move.start.values()) for move in first}) == POSTURES
    assert {move.joints[0] for move in planned.moves} == set(belief.robot.joint_names)
    for move in planned.moves:
        assert_within_limits(belief, move)
    with pytest.raises(ConfigError, match="lists no IMU"):
        plan_imu(replace(belief, robot=replace(belief.robot, imus=())), OPTIONS)


def test_no_joint_behind_all_imus_turns_for_them(belief: Belief) -> None:
    imu, *_ = belief.robot.imus
    for last in (1, belief.robot.n - 1):
        robot = replace(belief.robot, imus=(replace(imu, after_joint=last),))
        moves = plan_imu(replace(belief, robot=robot), OPTIONS).moves
        assert {j for move in moves for j in move.joints} == {
            *robot.joint_names[: last + 1]
        }


def test_a_session_holds_all_stages_in_order() -> None:
    robot = sample_robot("two_joint")
    plan = make_plan("all", robot, limits_of(robot, ramp_s=0.3), Stages(), OPTIONS)
    order = ["friction", "gravity", "imu-calib", "inertia", "validation"]
    assert list(plan.stages) == order
    placed = [order.index(move.stage) for move in plan.moves]
    assert placed == sorted(placed)
    assert all(
        len(move.joints) == 2 for move in plan.moves if move.stage == "validation"
    )
    assert len({move.name for move in plan.moves}) == len(plan.moves)
    assert plan.duration_s == pytest.approx(sum(move.duration_s for move in plan.moves))
    assert plan.total_s > plan.duration_s
    assert plan.duration_s == pytest.approx(
        sum(x.duration_s for x in plan.stages.values())
    )


@pytest.mark.slow
def test_what_gravity_tells_lowers_the_errors_of_inertia(belief: Belief) -> None:
    robot, limits = belief.robot, belief.limits
    alone = make_plan("inertia", robot, limits, Stages(), OPTIONS)
    session = make_plan("all", robot, limits, Stages(), OPTIONS)
    by_itself = {p.name: p.std_error for p in alone.stages["inertia"].parameters}
    later = {p.name: p.std_error for p in session.stages["inertia"].parameters}
    moments = [name for name in by_itself.keys() & later.keys() if name.startswith("m")]
    assert len(moments) == 10  # the moves are too few to compare the inertias
    # Both plans have moves of their own, which show one moment better than another.
    ratios = np.array([later[name] / by_itself[name] for name in moments])
    assert ratios.max() < 0.8
    assert np.exp(np.mean(np.log(ratios))) < 0.35
