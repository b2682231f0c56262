"""Thresholds of plans: each beside a case that it decides."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seqid_cli.plan import make
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.moves.floor import floor_of
from seqid_cli.plan.moves.strokes import postures_of
from seqid_cli.plan.settings import DiscriminationSettings, MarginSettings
from seqid_cli.robot.urdf import UrdfJoint
from tests.plants.robots.sample import sample_robot
from tests.unit.thresholds.witness import Witness, witnesses


def torque_has_room(settings: MarginSettings, sigma: float) -> bool:
    """Whether a move keeps more than so many standard errors of its torque."""
    belief: Any = SimpleNamespace(
        robot=sample_robot("one_joint"),
        theta=np.zeros(1),
        surfaces=[None],
        covariance_root=np.eye(1),
        margins=settings,
    )
    return planned_torque(belief) > sigma


def planned_torque(belief: Any) -> float:
    """Torque [N m] of a belief that knows nothing but a standard error of 1 N m."""
    moves: Any = SimpleNamespace(
        q=np.zeros((1, 1, 1)), dq=np.zeros((1, 1, 1)), ddq=np.zeros((1, 1, 1))
    )
    return float(Belief.torque(belief, moves, np.ones((1, 1, 1, 1))).max())


def kept_above(settings: MarginSettings, height: float) -> bool:
    """Whether a plan keeps the arm this high above the base plane."""
    robot = sample_robot("six_joint")
    limits = limits_of(robot, ramp_s=0.5)
    drawn = postures_of(limits, 50, np.random.default_rng(0))
    floor = floor_of(robot, limits, drawn, margins=settings)
    assert floor is not None
    return floor.clearance_m >= height


def too_weak(settings: DiscriminationSettings, power: float) -> bool:
    separation = SimpleNamespace(
        between=("a", "b"), powers=[power, power], imitations=[0.1, 0.1], power=power
    )
    planned: Any = SimpleNamespace(stage=SimpleNamespace(separation=separation))
    (verdict,) = make._verdicts("discriminate", planned, settings)
    return not verdict.good


WITNESSES = witnesses(
    "plan",
    [
        ("margins.torque_sigma", 2.4, 3.6, torque_has_room),
        ("margins.floor_clearance", 0.016, 0.024, kept_above),
        ("discrimination.min_power", 0.85, 0.95, too_weak),
    ],
)


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda one: one.setting)
def test_a_threshold_lies_where_it_should(witness: Witness) -> None:
    witness.check()


def test_a_plan_uses_less_than_the_limits_of_robot_file_and_urdf() -> None:
    """A twentieth is left for what a controller overshoots."""
    robot = sample_robot("two_joint")
    first, *others = robot.joints
    limited = replace(
        first,
        position_limits=(-1.0, 1.0),
        velocity_limit=2.0,
        urdf=UrdfJoint(
            name=first.name,
            kind="revolute",
            parent="base",
            child="link",
            follows="",
            axis=(0.0, 0.0, 1.0),
            lower=-9.0,
            upper=9.0,
            velocity=9.0,
            effort=40.0,
        ),
    )
    limits = limits_of(replace(robot, joints=(limited, *others)), ramp_s=0.5)
    assert 0.9 * 40.0 <= limits.torque[0] <= 0.96 * 40.0
    assert 0.9 * 2.0 <= limits.speed[0] <= 0.96 * 2.0
    assert 0.9 <= limits.upper[0] <= 0.96
    assert limits.acceleration[0] <= 0.96 * 2.0 / 0.5
