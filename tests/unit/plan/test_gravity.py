"""Plans of gravity: conditions, ranges of friction, and terms that every drive has."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from seqid_cli.motion.planned import sampled
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import FrictionStage, Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.coverage import Coverage, ramp_way
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.plan.stages.gravity import plan_gravity
from seqid_cli.plan.stages.gravity_sweeps.criterion import MINIMISED
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.robot.types import Array
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.stages import friction_stage
from tests.studies.planned.gravity import LongSearch
from tests.unit.plan.conftest import believed
from tests.unit.plan.test_sweeps import assert_within_limits

OPTIONS = PlanOptions(duration_s=24.0, move_s=6.0, pool=60, sweeps=1)
FEWER = 2  # sweeps of each joint, where it is not their postures that count


@pytest.fixture(scope="module")
def planned(belief: Belief) -> Planned:
    """Return the plan of gravity where no friction is known."""
    return plan_gravity(belief, Stages(), OPTIONS).gravity


def steady_rows(belief: Belief, move: PlannedMove) -> tuple[int, Array, Array]:
    """The joint of a sweep, its postures at speed, and its rows of H_g."""
    _, q, dq, _ = sampled(move, belief.robot.joint_names, 50.0)
    j = belief.robot.joint_names.index(move.joints[0])
    steady = np.abs(dq[:, j]) > (1.0 - 1e-6) * move.strokes[0].speed
    still = np.zeros_like(q)
    H = base_regressor(belief.robot, belief.basis, q, still, still)
    return j, q[steady], H[steady][:, j][:, belief.basis.gravity]


def conditions_of(belief: Belief, moves: list[PlannedMove]) -> tuple[float, float]:
    """Condition of Phi(H_g) (Eq. 20) from the moves themselves; the same of unit
    columns.
    """
    stacked = np.concatenate([steady_rows(belief, move)[2] for move in moves])
    unit = stacked / np.linalg.norm(stacked, axis=0)
    return float(np.linalg.cond(stacked)), float(np.linalg.cond(unit))


@pytest.mark.slow
def test_both_conditions_come_near_the_best_of_a_long_search(
    belief: Belief, planned: Planned
) -> None:
    for move in planned.moves:
        assert_within_limits(belief, move)
    stage = planned.stage
    assert stage.rank == stage.structural_rank == int(belief.basis.gravity.sum())
    plain, scaled = conditions_of(belief, planned.moves)
    assert stage.plain_condition == pytest.approx(plain, rel=0.03)
    assert stage.scaled_condition == pytest.approx(scaled, rel=0.03)
    assert stage.criterion is not None
    assert stage.criterion.minimised == MINIMISED
    product = (stage.plain_condition or 0.0) * (stage.scaled_condition or 0.0)
    assert stage.criterion.value == pytest.approx(product)

    sweeps = [steady_rows(belief, move) for move in planned.moves]
    search = LongSearch(
        robot=belief.robot,
        joints=np.array([j for j, _, _ in sweeps]),
        ends=np.array([[q[:, j].min(), q[:, j].max()] for j, q, _ in sweeps]),
        speed=np.array([move.strokes[0].speed for move in planned.moves]),
        lower=belief.limits.lower,
        upper=belief.limits.upper,
    )
    assert plain < 1.1 * search.least(scaled=False, starts=2, seed=0)
    assert scaled < 1.1 * search.least(scaled=True, starts=2, seed=0)


@pytest.mark.slow
def test_joints_that_gravity_loads_by_rounding_alone_get_no_sweeps(
    belief: Belief, planned: Planned
) -> None:
    moved = [move.joints[0] for move in planned.moves]
    assert set(moved) == set(belief.robot.joint_names) - {"shoulder_pan"}
    assert all(moved.count(name) == 3 for name in set(moved))


def test_gravity_of_a_planar_arm_has_nothing_to_record() -> None:
    robot = replace(sample_robot("two_joint"), gravity=np.zeros(3))
    belief = belief_of(robot, Stages(), limits_of(robot, ramp_s=0.3))
    planned = plan_gravity(belief, Stages(), OPTIONS).gravity
    assert not planned.moves
    assert "nothing to record" in planned.stage.notes[0]


def narrowed(
    stage: FrictionStage, joint: str, low: float, high: float
) -> FrictionStage:
    """The same stage, one joint identified between two positions alone."""
    surface = msgspec.structs.replace(stage.joints[joint], position_range=[low, high])
    return msgspec.structs.replace(stage, joints={**stage.joints, joint: surface})


@pytest.mark.slow
def test_sweeps_keep_to_the_friction_that_is_given() -> None:
    robot = sample_robot("six_joint")
    stages = Stages(friction=narrowed(friction_stage(robot), "elbow", -0.8, 0.9))
    belief = believed("six_joint", stages)
    planned = plan_gravity(belief, stages, OPTIONS, per_joint=FEWER)
    coverage = Coverage.of_surfaces(belief)
    for move in planned.gravity.moves:
        j, q, _ = steady_rows(belief, move)
        surface = belief.surfaces[j]
        assert surface is not None
        speed = np.full(len(q), move.strokes[0].speed)
        assert not surface.outside(q[:, j], speed).any(), move.name
        assert coverage.slowest[j] <= speed[0] <= coverage.fastest[j]
    # More range would pay: said, with the trials that it needs.
    assert planned.friction is not None
    assert [move.joints for move in planned.friction.moves] == [["elbow"]]
    stroke = planned.friction.moves[0].strokes[0]
    assert abs(stroke.end - stroke.start) > 4.0
    assert any("more range would pay" in note for note in planned.gravity.stage.notes)


@pytest.mark.slow
def test_a_joint_without_friction_gets_trials_and_no_sweeps() -> None:
    robot = sample_robot("six_joint")
    stage = friction_stage(robot)
    stage = msgspec.structs.replace(
        stage,
        joints={
            name: surface for name, surface in stage.joints.items() if name != "elbow"
        },
    )
    stages = Stages(friction=stage)
    belief = believed("six_joint", stages)
    planned = plan_gravity(belief, stages, OPTIONS, per_joint=FEWER)
    assert all(move.joints != ["elbow"] for move in planned.gravity.moves)
    assert any("elbow" in note for note in planned.gravity.stage.notes)


def test_planned_friction_covers_what_gravity_sweeps(planned: Planned) -> None:
    assert any("friction has to be known first" in note for note in planned.stage.notes)
    for move in planned.moves:
        stroke = move.strokes[0]
        ramp = ramp_way(stroke.speed, stroke.acceleration)
        assert abs(stroke.end - stroke.start) > 2.0 * ramp


@pytest.mark.slow
def test_an_unknown_offset_bounds_what_a_plan_promises(belief: Belief) -> None:
    """However little noise there is, offset and asymmetry are not told from gravity for
    ever.
    """
    quiet = replace(belief, information_rate=1e8 * belief.information_rate)
    without = replace(quiet, friction=np.zeros(belief.robot.n))
    with_offset, by_noise_alone = (
        plan_gravity(one, Stages(), OPTIONS, per_joint=FEWER).gravity.stage
        for one in (quiet, without)
    )
    promised = {p.name: p.std_error for p in by_noise_alone.parameters}
    ratios = [p.std_error / promised[p.name] for p in with_offset.parameters]
    assert min(ratios) >= 1.0 - 1e-9
    assert max(ratios) > 1.5
