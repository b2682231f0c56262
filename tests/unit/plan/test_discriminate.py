"""Telling two effects apart: the residual that the rival cannot imitate, and what is
refused.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from seqid_cli.discover.select.options import Options
from seqid_cli.effects.scene import Scene
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.discrimination.discriminate import (
    effects_and_joint,
    plan_discriminate,
    pool_of,
)
from seqid_cli.plan.discrimination.question import Question
from seqid_cli.plan.discrimination.separation import Outcome, scenes_of, separation_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Planned
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.robots.lab import robot_of
from tests.plants.robots.stages import inertia_stage

PAIR = ("stribeck", "quadratic_drag")
OPTIONS = PlanOptions(duration_s=24.0, move_s=6.0, between=PAIR, joint="elbow")


@cache
def known() -> Stages:
    plant = vertical_two_joint()
    return Stages(inertia=inertia_stage(robot_of("two", plant), plant.arm.phi))


@cache
def believed() -> Belief:
    robot = robot_of("two", vertical_two_joint())
    return belief_of(robot, known(), limits_of(robot, ramp_s=0.4))


@cache
def moves_for(options: PlanOptions) -> Planned:
    """Moves that tell two effects apart: several tests ask for the same."""
    return plan_discriminate(believed(), known(), options)


@pytest.mark.slow
def test_the_gain_and_what_the_rival_leaves_are_those_of_least_squares() -> None:
    scenes = scenes_for(moves_for(OPTIONS).moves)
    separation = separation_of(believed(), question_of(OPTIONS, scenes), scenes, 1.0)
    question = separation.question
    of_moves = separation.grams.sum(axis=0)
    total = of_moves + separation.prior

    # The same by a QR of the rows: with the rival's settings one by one, the least
    # residual counts.
    root = np.linalg.cholesky(total + 1e-10 * np.diag(np.diag(total))).T
    base, effects = np.split(root, [question.n_base], axis=1)
    n_refused = 0
    for k in (0, 1):
        slot, drawn = separation.readings[k][0][0]
        true_torque = effects[:, slot.at] @ drawn[0]
        by_base = float(np.linalg.lstsq(base, true_torque)[1][0])
        by_rivals = []
        for rival in question.slots[1 - k]:
            X = np.hstack([base, effects[:, rival.at]])
            coefficients, square = np.linalg.lstsq(X, true_torque)[:2]
            # Both effects ask that their coefficient is not negative.
            if coefficients[-1] >= 0.0:
                by_rivals.append(float(square[0]))
            else:
                n_refused += 1

        outcome = separation.outcome(of_moves, k)
        assert 2.0 * outcome.gain[0] == pytest.approx(by_base, rel=1e-3)
        least = min([by_base, *by_rivals])
        assert outcome.rival_leaves[0] == pytest.approx(least, rel=1e-3)
    assert n_refused > 0


def scenes_for(moves: Sequence[PlannedMove]) -> list[Scene]:
    return scenes_of(believed(), known(), moves)


def question_of(options: PlanOptions, scenes: Sequence[Scene]) -> Question:
    return Question.of(
        believed(), *effects_and_joint(believed().robot, options), scenes
    )


def test_power_is_what_the_diagnosis_asks() -> None:
    gain = 4000.0
    required = Options().negligible_share * gain
    lack = np.array([[required], [2.0 * required], [0.5 * required]])
    outcome = Outcome(np.full((3, 1), gain), 2.0 * lack)
    assert outcome.power == pytest.approx([0.5, 1.0, 0.0], abs=1e-3)
    # Time does not help where the rival lacks too small a share, and does where noise
    # hides it.
    assert outcome.longer(100.0).power == pytest.approx([0.5, 1.0, 0.0], abs=1e-3)
    weak = Outcome(np.array([20.0]), np.array([4.0]))
    assert float(weak.power) < 0.5 < 0.99 < float(weak.longer(20.0).power)


# Pair, special case, bounds of both powers, least imitation of the first, verdict,
# note. A dry asymmetry differs from a bias on no motion; a power of 1.8 imitates
# quadratic drag, which is no cubic; a lag is never early.
TOLD = [
    (("asymmetric_friction", "torque_bias"), "torque_bias", (0, 0), (0.96, 0), 0.953,
     "", "brakes"),
    (("quadratic_drag", "nonlinear_viscous"), None, (0, 0.5), (0.01, 1), 0.98,
     "if it is quadratic_drag", "ladder"),
    (("torque_bias", "spring"), "torque_bias", (0, 0), (1e-3, 1), 0.0,
     "if it is torque_bias, the diagnosis drops spring with probability 0 %",
     "brakes on"),
    (("time_skew", "actuator_lag"), "actuator_lag", (0.499, 0), (0.501, 1e-3), 0.0,
     "", ""),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", TOLD, ids=lambda case: "-".join(case[0]))
def test_what_no_motion_settles_is_said(case: tuple[Any, ...]) -> None:
    pair, special, low, high, imitated, reason, note = case
    belief = believed()
    asking = replace(OPTIONS, between=pair)
    file = make_plan("discriminate", belief.robot, belief.limits, known(), asking)
    stage = file.stages["discriminate"]
    verdict = file.verdicts[0]
    separation = stage.separation
    assert separation.special_case == special
    for power, least, most in zip(separation.powers, low, high, strict=True):
        assert least <= power <= most
    assert separation.power == min(separation.powers)
    assert separation.seconds_needed is None or separation.power > 0.0
    assert separation.imitations[0] >= imitated
    assert not verdict.good
    assert reason in verdict.reason
    assert note in stage.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize("viscous", [0.0, 1.0])
def test_chances_are_of_what_the_logs_show(viscous: float) -> None:
    """No motion shows that a dry asymmetry is no bias; of a viscous one it does."""
    pair = replace(OPTIONS, between=("asymmetric_friction", "torque_bias"))
    planned = scenes_for(moves_for(pair).moves)
    question = question_of(pair, planned)
    logs = []
    for scene in planned[:2]:
        tau = scene.modelled_filtered.copy()
        tau[:, 1] += viscous * np.abs(scene.motion.dq[:, 1]) + 0.2
        logs.append(replace(scene, motion=replace(scene.motion, tau=tau)))
    separation = separation_of(believed(), question, planned, 1.0, logs)
    of_moves = separation.grams.sum(axis=0)
    power = float(separation.least_certain_outcome(of_moves, 0).power)

    # Without the first reading, which is that of the logs.
    first, second = separation.readings
    without_logs = replace(separation, readings=(first[1:], second[1:]))
    by_itself = float(without_logs.least_certain_outcome(of_moves, 0).power)
    assert 0.7 < by_itself < 0.95
    if viscous:
        assert power == pytest.approx(by_itself)
    else:
        assert power < 0.2 * by_itself
    speeds = np.concatenate([scene.motion.dq[:, 1] for scene in logs])
    size = np.sqrt(np.mean((viscous * np.abs(speeds) + 0.2) ** 2))
    assert separation.torque_size == pytest.approx(size, rel=0.3)


@pytest.mark.slow
def test_chosen_moves_beat_random_ones() -> None:
    chosen = moves_for(OPTIONS)
    pool = pool_of(believed(), 1, OPTIONS)
    many = len(chosen.moves)
    scenes = scenes_for([*chosen.moves, *pool])
    question = question_of(OPTIONS, scenes[many :: len(pool) // 12])  # as the plan asks
    size = chosen.stage.separation.size
    separation = separation_of(believed(), question, scenes, size)
    grams = separation.grams
    rng = np.random.default_rng(0)
    sets = [many + rng.choice(len(pool), many, replace=False) for _ in range(300)]
    by_chance = [float(separation.merit(grams[s].sum(axis=0))) for s in sets]
    assert float(separation.merit(grams[:many].sum(axis=0))) > max(by_chance)
    short = moves_for(replace(OPTIONS, duration_s=12.0)).stage.separation
    assert chosen.stage.separation.distance > 1.1 * short.distance
    assert chosen.stage.separation.power > short.power
