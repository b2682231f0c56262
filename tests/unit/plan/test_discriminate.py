"""Telling two effects apart: the residual that the rival cannot imitate, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.errors import UsageError
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.discriminate import asked, plan_discriminate
from seqid_cli.plan.stages.separation import Question, scenes_of, separation_of
from tests.plants.robots.lab import robot_of
from tests.plants.robots.stages import inertia_stage
from tests.plants.vertical import vertical_two_joint

PAIR = ("stribeck", "quadratic_drag")
OPTIONS = PlanOptions(duration_s=24.0, move_s=6.0, between=PAIR, joint="elbow")


@pytest.fixture(scope="module")
def stages() -> Stages:
    plant = vertical_two_joint()
    robot = robot_of("two", plant)
    return Stages(inertia=inertia_stage(robot, plant.arm.phi))


@pytest.fixture(scope="module")
def belief(stages: Stages) -> Belief:
    robot = robot_of("two", vertical_two_joint())
    return belief_of(robot, stages, limits_of(robot, ramp_s=0.4))


def test_t_is_the_residual_of_least_squares(belief: Belief, stages: Stages) -> None:
    planned = plan_discriminate(belief, stages, OPTIONS)
    scenes = scenes_of(belief, stages, planned.moves)
    both, joint = asked(belief.robot, OPTIONS)
    question = Question.of(both, joint, scenes)
    found = separation_of(belief, question, scenes)
    total = found.of.sum(axis=0) + found.prior
    # The same by a QR of the rows: with the rival's settings one by one, the least residual counts.
    root = np.linalg.cholesky(total + 1e-10 * np.diag(np.diag(total))).T
    own = root[:, found.base :][:, found.slots[0][0]]
    nuisance, effects = root[:, : found.base], root[:, found.base :]
    left = min(
        float(np.linalg.lstsq(np.hstack([nuisance, effects[:, b]]), own)[1][0])
        for b in found.slots[1]
    )
    told = found.leaves(found.of.sum(axis=0), 0)[0][0]
    assert told * float(found.size[0][0][0, 0]) == pytest.approx(left, rel=1e-3)


def test_more_moves_tell_more(belief: Belief, stages: Stages) -> None:
    short = plan_discriminate(belief, stages, replace(OPTIONS, duration_s=12.0)).stage.separation
    long = plan_discriminate(belief, stages, OPTIONS).stage.separation
    assert short is not None
    assert long is not None
    assert long.distance > 1.1 * short.distance
    assert long.power > short.power
    assert 0.0 <= long.imitated < 0.95


def test_the_first_moves_beat_random_ones(belief: Belief, stages: Stages) -> None:
    planned = plan_discriminate(belief, stages, replace(OPTIONS, duration_s=120.0))
    scenes = scenes_of(belief, stages, planned.moves)
    effects, joint = asked(belief.robot, OPTIONS)
    found = separation_of(belief, Question.of(effects, joint, scenes), scenes)
    rng = np.random.default_rng(0)
    sets = [rng.choice(len(scenes), 4, replace=False) for _ in range(100)]
    chance = [float(found.value(found.of[s].sum(axis=0))) for s in sets]
    assert float(found.value(found.of[:4].sum(axis=0))) > np.quantile(chance, 0.9)


def test_a_special_case_and_a_pair_beyond_motion_are_named(belief: Belief, stages: Stages) -> None:
    nested = replace(OPTIONS, between=("torque_bias", "spring"))
    told = plan_discriminate(belief, stages, nested).stage.separation
    assert told is not None
    assert told.special_case == "torque_bias"
    file = make_plan("discriminate", belief.robot, belief.limits, stages, nested)
    assert not file.verdicts[0].good
    assert "torque_bias is a special case of spring" in file.verdicts[0].reason
    assert "brakes on" in file.stages["discriminate"].notes[0]
    same = plan_discriminate(
        belief, stages, replace(OPTIONS, between=("time_skew", "actuator_lag"))
    )
    assert not same.moves
    assert "no motion tells time_skew from actuator_lag" in same.stage.notes[0]


def test_a_rival_has_the_settings_that_a_diagnosis_may_refine(
    belief: Belief, stages: Stages
) -> None:
    pair = replace(OPTIONS, between=("quadratic_drag", "nonlinear_viscous"), duration_s=12.0)
    moves = plan_discriminate(belief, stages, replace(OPTIONS, duration_s=12.0)).moves
    both, joint = asked(belief.robot, pair)
    settings = Question.of(both, joint, scenes_of(belief, stages, moves)).settings[1]
    exponents = [one["exponent"] for one in settings]
    near = min(abs(x - 2.0) for x in exponents)
    assert 0.2 <= near < 0.3  # nearer ones go by the other's name
    assert min(exponents) == 0.3
    assert max(exponents) == 4.0


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
