"""Plans for inertia and for payloads."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, typical
from seqid_cli.plan.moves.fourier import COARSE_HZ, placed
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Goal
from seqid_cli.plan.stages.inertia import plan_inertia
from seqid_cli.plan.stages.payload import loaded, plan_payload
from seqid_cli.plan.stages.search import assess, choose, draw_pool, groups_of, refine
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.robot.types import Array
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.stages import friction_stage, inertia_stage
from tests.unit.plan.conftest import believed

Pool = tuple[Array, Array]  # moves that were drawn, their information
SECONDS = 6.0
COUNT = 8
OPTIONS = PlanOptions(duration_s=20.0, move_s=5.0, pool=40, sweeps=1)


@pytest.fixture(scope="module")
def goal(belief: Belief) -> Goal:
    return Goal.of(belief, seed=0)


@pytest.fixture(scope="module")
def pool(belief: Belief, goal: Goal) -> Pool:
    groups = groups_of(belief.limits, together=False)
    shapes = Shapes.over(SECONDS, COARSE_HZ)
    return draw_pool(belief, goal, shapes, groups, 150, np.random.default_rng(0))


def test_information_is_that_of_the_regressor(
    belief: Belief, goal: Goal, pool: Pool
) -> None:
    shapes = Shapes.over(SECONDS, COARSE_HZ)
    moves = placed(shapes, pool[0][[4]], belief.limits).every(4)
    H = base_regressor(
        belief.robot, belief.basis, moves.q[0], moves.dq[0], moves.ddq[0]
    )
    slide = moves.dq[0] ** 2 / (moves.dq[0] ** 2 + belief.slow_speed**2)
    step_s = moves.t[1] - moves.t[0]
    expected = np.zeros((belief.basis.size, belief.basis.size))
    for j, density in enumerate(belief.information_rate):
        rows = H[:, j]
        weighted = density * step_s * slide[:, j, None] * rows
        expected += rows.T @ weighted
    information = pool[1][4] * np.outer(goal.scale, goal.scale)
    tolerance = 1e-9 * np.abs(expected).max()
    assert np.allclose(information, expected, rtol=1e-9, atol=tolerance)


def test_greedy_choice_beats_every_one_of_a_thousand_random_sets(
    goal: Goal, pool: Pool
) -> None:
    nothing = np.zeros_like(goal.W)
    chosen = choose(goal, pool[1], COUNT, nothing)
    assert len(set(chosen)) == COUNT
    same_but_smaller = pool[1][:1] * np.array([1.0, 0.1, 0.01])[:, None, None]
    assert sorted(choose(goal, same_but_smaller, 5, nothing)) == [0, 1, 2]  # each once
    rng = np.random.default_rng(1)
    sets = [rng.choice(len(pool[0]), COUNT, replace=False) for _ in range(1000)]
    chance = [float(goal.errors(pool[1][s].sum(axis=0))) for s in sets]
    assert goal.errors(pool[1][chosen].sum(axis=0)) < min(chance)


@pytest.mark.slow
def test_refinement_lowers_the_error(belief: Belief, goal: Goal, pool: Pool) -> None:
    nothing = np.zeros_like(goal.W)
    shapes = Shapes.over(SECONDS, COARSE_HZ)
    chosen = choose(goal, pool[1], COUNT, nothing)
    better = refine(belief, goal, shapes, pool[0][chosen], nothing, sweeps=1)
    information, overload = assess(belief, goal, placed(shapes, better, belief.limits))
    unrefined_error = float(goal.errors(pool[1][chosen].sum(axis=0)))
    assert float(goal.errors(information.sum(axis=0))) < 0.9 * unrefined_error
    assert overload.max() <= 1.0

    # The same joints move as before.
    moving = better[..., :COEFFICIENTS].any(axis=2)
    moving_unrefined = pool[0][chosen][..., :COEFFICIENTS].any(axis=2)
    assert np.array_equal(moving, moving_unrefined)


@pytest.mark.parametrize(
    "name",
    ["one_joint", "two_joint", pytest.param("six_joint", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("together", [False, True])
def test_sample_arms_get_full_rank(name: str, together: bool) -> None:
    belief = believed(name)
    options = PlanOptions(
        duration_s=48.0, move_s=SECONDS, together=together, pool=80, sweeps=1
    )
    planned = plan_inertia(belief, Stages(), options)
    assert planned.stage.rank == planned.stage.structural_rank == belief.basis.size
    assert not planned.stage.not_excited
    assert len(planned.stage.parameters) == belief.basis.size
    errors = [growth.error for growth in planned.stage.growth]
    assert all(second < first for first, second in pairwise(errors))


@pytest.mark.slow
def test_the_same_seed_gives_the_same_plan(belief: Belief) -> None:
    options = PlanOptions(duration_s=12.0, move_s=SECONDS, pool=30, sweeps=1)
    first = plan_inertia(belief, Stages(), options)
    assert first == plan_inertia(belief, Stages(), options)
    assert first != plan_inertia(belief, Stages(), replace(options, seed=1))


@pytest.mark.slow
def test_all_ten_parameters_are_found_on_six_joints() -> None:
    robot = sample_robot("six_joint")
    assert robot.nominal is not None
    stages = Stages(
        friction=friction_stage(robot), inertia=inertia_stage(robot, robot.nominal)
    )
    errors = []
    for options in (OPTIONS, replace(OPTIONS, duration_s=40.0)):
        planned = plan_payload(believed("six_joint", stages), stages, options)
        assert planned.stage.rank == planned.stage.structural_rank == 10
        errors.append(np.array([p.std_error for p in planned.stage.parameters]))
    assert len(errors[0]) == 10
    assert np.median(errors[1] / errors[0]) < 0.95


def test_the_load_counts_in_the_torque(belief: Belief) -> None:
    moves = typical(belief, seed=0)
    plain, heavy = (
        loaded(belief, mass).torque(moves, belief.regressor(moves)) for mass in (0, 5)
    )
    largest_plain = plain[:, :, 1:3].max(axis=(0, 1))
    largest_heavy = heavy[:, :, 1:3].max(axis=(0, 1))
    assert np.all(largest_heavy > largest_plain)


def test_a_planar_arm_names_what_stays_open() -> None:
    robot = sample_robot("two_joint")
    phi = np.tile([1.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02], (2, 1))
    stages = Stages(inertia=inertia_stage(robot, phi))
    stage = plan_payload(believed("two_joint", stages), stages, OPTIONS).stage
    assert stage.rank == stage.structural_rank == 4
    assert set(stage.not_excited) >= {"payload_mz", "payload_Ixx"}
    assert {p.name for p in stage.parameters} == {
        f"payload_{k}" for k in ("m", "mx", "my", "Izz")
    }
