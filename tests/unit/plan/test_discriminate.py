"""Telling two effects apart: the residual that the rival cannot imitate, and what is refused."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seqid_cli.discover.select.naming import TEMPER
from seqid_cli.errors import UsageError
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.discrimination.discriminate import asked, plan_discriminate, pool_of
from seqid_cli.plan.discrimination.question import Question
from seqid_cli.plan.discrimination.separation import (
    BEHIND,
    Separation,
    Told,
    scenes_of,
    separation_of,
)
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.typing import Array
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.robots.lab import robot_of
from tests.plants.robots.stages import inertia_stage

PAIR = ("stribeck", "quadratic_drag")
OPTIONS = PlanOptions(duration_s=24.0, move_s=6.0, between=PAIR, joint="elbow")


@pytest.fixture(scope="module")
def stages() -> Stages:
    return known()


@cache
def known() -> Stages:
    plant = vertical_two_joint()
    return Stages(inertia=inertia_stage(robot_of("two", plant), plant.arm.phi))


@pytest.fixture(scope="module")
def belief() -> Belief:
    return believed()


@cache
def believed() -> Belief:
    robot = robot_of("two", vertical_two_joint())
    return belief_of(robot, known(), limits_of(robot, ramp_s=0.4))


@cache
def moves_for(options: PlanOptions) -> Planned:
    """Moves that tell two effects apart: several tests ask for the same."""
    return plan_discriminate(believed(), known(), options)


@pytest.mark.slow
def test_the_gain_and_what_the_rival_leaves_are_those_of_least_squares(
    belief: Belief, stages: Stages
) -> None:
    scenes = scenes_of(belief, stages, moves_for(OPTIONS).moves)
    found = _separation(belief, OPTIONS, scenes)
    total = found.of.sum(axis=0) + found.prior
    # The same by a QR of the rows: with the rival's settings one by one, the least residual counts.
    root = np.linalg.cholesky(total + 1e-10 * np.diag(np.diag(total))).T
    base, effects = root[:, : found.base], root[:, found.base :]
    negative = 0
    for k in (0, 1):
        slot, drawn = found.true[k][0][0]
        own = effects[:, slot.at] @ drawn[0]
        rivals = [np.hstack([base, effects[:, b.at]]) for b in found.slots[1 - k]]
        fits = [np.linalg.lstsq(X, own)[:2] for X in rivals]
        alone = float(np.linalg.lstsq(base, own)[1][0])
        fit = [float(square[0]) for c, square in fits if c[-1] >= 0.0]  # as both effects ask
        negative += len(fits) - len(fit)
        told = found.told(found.of.sum(axis=0), k)
        assert 2.0 * told.gain[0] == pytest.approx(alone, rel=1e-3)
        assert told.left[0] == pytest.approx(min([alone, *fit]), rel=1e-3)
    assert negative > 0


def _separation(belief: Belief, options: PlanOptions, scenes: Sequence[Scene]) -> Separation:
    effects, joint = asked(belief.robot, options)
    return separation_of(belief, Question.of(effects, joint, scenes), scenes, 1.0)


def test_parts_of_the_base_that_no_move_shows_take_nothing_of_an_effect() -> None:
    # Base columns: one that moves show, its double, and one that is zero; then the effect's.
    rows = np.random.default_rng(0).normal(size=(50, 2))
    X = np.column_stack([rows[:, 0], 2.0 * rows[:, 0], np.zeros(50), rows[:, 1]])
    gram = X.T @ X
    found = Separation(3, ([], []), np.zeros((4, 4)), gram[None], ([], []), 1.0)
    left = rows[:, 1] - rows[:, 0] * (rows[:, 0] @ rows[:, 1]) / (rows[:, 0] @ rows[:, 0])
    assert found.effects(gram) == pytest.approx(left @ left, rel=1e-6)


def test_power_is_what_the_diagnosis_asks() -> None:
    gain = 4000.0
    asked_for = BEHIND * TEMPER * gain  # 4.7 % of it
    lacking = np.array([[asked_for], [2.0 * asked_for], [0.5 * asked_for]])
    told = Told(np.full((3, 1), gain), 2.0 * lacking)
    assert told.power == pytest.approx([0.5, 1.0, 0.0], abs=1e-3)
    # Time does not help where the rival lacks too small a share, and does where noise hides it.
    assert told.longer(100.0).power == pytest.approx([0.5, 1.0, 0.0], abs=1e-3)
    weak = Told(np.array([20.0]), np.array([4.0]))
    assert float(weak.power) < 0.5 < 0.99 < float(weak.longer(20.0).power)


@pytest.mark.slow
def test_the_part_that_both_share_hides_nothing(belief: Belief, stages: Stages) -> None:
    """Of asymmetric friction the viscous part differs from a bias, the dry one on no motion."""
    pair = replace(OPTIONS, between=("asymmetric_friction", "torque_bias"))
    file = make_plan("discriminate", belief.robot, belief.limits, stages, pair)
    told = file.stages["discriminate"].separation
    assert told.imitations[0] > 0.953
    assert told.powers[0] < 0.95
    assert told.power == told.powers[1] == 0.0
    assert told.seconds_needed is None
    assert not file.verdicts[0].good
    assert "brakes on" in file.stages["discriminate"].notes[0]


@pytest.mark.slow
def test_of_two_laws_one_can_be_shown_and_the_other_cannot(belief: Belief, stages: Stages) -> None:
    """A cubic is no quadratic drag; a power of 1.8 imitates it."""
    pair = replace(OPTIONS, between=("quadratic_drag", "nonlinear_viscous"))
    file = make_plan("discriminate", belief.robot, belief.limits, stages, pair)
    told = file.stages["discriminate"].separation
    assert told.special_case is None
    assert told.powers[0] < 0.01
    assert told.powers[1] > 0.5
    assert told.imitations[0] > 0.98
    assert not file.verdicts[0].good
    assert "if it is quadratic_drag" in file.verdicts[0].reason
    assert "ladder" in file.stages["discriminate"].notes[0]


@pytest.mark.slow
def test_logs_that_there_are_count(belief: Belief, stages: Stages) -> None:
    """A log on which the rival imitates the effect takes away from what the moves show."""
    moves = moves_for(OPTIONS).moves[:2]
    scenes = scenes_of(belief, stages, moves)
    effects, joint = asked(belief.robot, OPTIONS)
    question = Question.of(effects, joint, scenes)
    alone = separation_of(belief, question, scenes, 1.0)
    joined = separation_of(belief, question, scenes[1:], 1.0, scenes[:1])
    joined = replace(joined, true=alone.true)
    both, rest = alone.of.sum(axis=0), joined.of.sum(axis=0)
    for k in (0, 1):
        assert joined.told(rest, k).left == pytest.approx(alone.told(both, k).left, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("viscous", [0.0, 1.0])
def test_chances_are_of_what_the_logs_show(belief: Belief, stages: Stages, viscous: float) -> None:
    """No motion shows that a dry asymmetry is no bias; of a viscous one it does."""
    pair = replace(OPTIONS, between=("asymmetric_friction", "torque_bias"))
    moves = moves_for(pair).moves
    planned = scenes_of(belief, stages, moves)
    effects, joint = asked(belief.robot, pair)
    question = Question.of(effects, joint, planned)
    logs = [_with(scene, viscous * np.abs(scene.motion.dq[:, 1]) + 0.2) for scene in planned[:2]]
    found = separation_of(belief, question, planned, 1.0, logs)
    power = float(found.surely(found.of.sum(axis=0), 0).power)
    everywhere = replace(found, true=(found.true[0][1:], found.true[1][1:]))
    by_itself = float(everywhere.surely(found.of.sum(axis=0), 0).power)
    assert 0.7 < by_itself < 0.95
    if viscous:
        assert power == pytest.approx(by_itself)
    else:
        assert power < 0.2 * by_itself
    speeds = np.concatenate([scene.motion.dq[:, 1] for scene in logs])
    size = np.sqrt(np.mean((viscous * np.abs(speeds) + 0.2) ** 2))
    assert found.size == pytest.approx(size, rel=0.3)


def _with(scene: Scene, more: Array) -> Scene:
    """The same data set, with more torque at the second joint."""
    tau = scene.modelled_filtered.copy()
    tau[:, 1] += more
    return replace(scene, motion=replace(scene.motion, tau=tau))


@pytest.mark.slow
def test_more_moves_tell_more(belief: Belief, stages: Stages) -> None:
    short = moves_for(replace(OPTIONS, duration_s=12.0)).stage.separation
    long = moves_for(OPTIONS).stage.separation
    assert long.distance > 1.1 * short.distance
    assert long.power > short.power
    assert 0.0 <= long.imitated < 0.95


@pytest.mark.slow
def test_chosen_moves_beat_random_ones(belief: Belief, stages: Stages) -> None:
    chosen = moves_for(OPTIONS)
    pool = pool_of(belief, 1, OPTIONS)
    many = len(chosen.moves)
    scenes = scenes_of(belief, stages, [*chosen.moves, *pool])
    effects, joint = asked(belief.robot, OPTIONS)
    question = Question.of(effects, joint, scenes[many :: len(pool) // 12])  # as the plan asks
    found = separation_of(belief, question, scenes, chosen.stage.separation.size)
    rng = np.random.default_rng(0)
    sets = [many + rng.choice(len(pool), many, replace=False) for _ in range(300)]
    chance = [float(found.value(found.of[s].sum(axis=0))) for s in sets]
    assert float(found.value(found.of[:many].sum(axis=0))) > max(chance)


@pytest.mark.slow
def test_a_special_case_is_named(belief: Belief, stages: Stages) -> None:
    nested = replace(OPTIONS, between=("torque_bias", "spring"))
    told = moves_for(nested).stage.separation
    assert told.special_case == "torque_bias"
    file = make_plan("discriminate", belief.robot, belief.limits, stages, nested)
    assert not file.verdicts[0].good
    assert "if it is torque_bias, the diagnosis drops spring with probability 0 %" in (
        file.verdicts[0].reason
    )
    assert "brakes on" in file.stages["discriminate"].notes[0]
    skew = replace(OPTIONS, between=("time_skew", "actuator_lag"))
    told = moves_for(skew).stage.separation
    assert told.special_case == "actuator_lag"
    assert told.powers == pytest.approx([0.5, 0.0], abs=1e-3)  # a lag is never early


@pytest.mark.slow
def test_a_rival_has_the_settings_that_a_diagnosis_may_refine(
    belief: Belief, stages: Stages
) -> None:
    pair = replace(OPTIONS, between=("quadratic_drag", "nonlinear_viscous"), duration_s=12.0)
    moves = moves_for(replace(OPTIONS, duration_s=12.0)).moves
    both, joint = asked(belief.robot, pair)
    question = Question.of(both, joint, scenes_of(belief, stages, moves))
    grid, exponents = (
        [one["exponent"] for one in some]
        for some in (
            question.settings[1][: question.true[1]],
            question.settings[1][question.true[1] :],
        )
    )
    assert grid == [0.5, 3.0]
    assert min(exponents) == 0.3
    assert max(exponents) == 4.0
    assert not any(1.8 < x < 2.2 for x in exponents)  # those go by the other's name
    assert any(1.65 <= x <= 1.8 for x in exponents)
    assert any(2.2 <= x <= 2.3 for x in exponents)


@pytest.mark.parametrize(
    ("between", "joint", "text"),
    [
        (("stribek", "spring"), "elbow", "names no effect: 'stribek'"),
        (("spring", "spring"), "elbow", "two effects"),
        (("drift", "torque_bias"), "elbow", "no planned motion settles whether it is drift"),
        (PAIR, "wrist", "--joint names no joint: 'wrist'"),
        (PAIR, None, "needs --joint"),
    ],
)
def test_what_cannot_be_asked_is_told(
    belief: Belief, between: tuple[str, ...], joint: str | None, text: str
) -> None:
    with pytest.raises(UsageError, match=text):
        asked(belief.robot, replace(OPTIONS, between=between, joint=joint))
