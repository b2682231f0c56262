"""Limits: where they come from, that they hold on dense samples, and what is said
without them.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of, typical
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.moves.fourier import placed
from seqid_cli.plan.options import PlanOptions, What
from seqid_cli.plan.stages.payload import loaded
from seqid_cli.robot.types import Imu
from tests.plants.arms.rigs import six_joint, two_joint
from tests.plants.planned import limits_used
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.stages import inertia_stage

RIGS = ("one_joint", "two_joint", "six_joint")
BODIES = {"two_joint": two_joint().arm.phi, "six_joint": six_joint().arm.phi}
# between the samples on which the amplitude was found, of which 5 % are spare
ROUNDING = 1e-3


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    rig=st.sampled_from(RIGS), draw=st.integers(0, 2**31), seconds=st.floats(2.0, 20.0)
)
def test_limits_hold_on_dense_samples(rig: str, draw: int, seconds: float) -> None:
    robot = sample_robot(rig)
    limits = limits_of(robot, ramp_s=0.3)
    rng = np.random.default_rng(draw)
    size = (3, robot.n)
    coefficients = rng.uniform(-1.0, 1.0, (*size, COEFFICIENTS))
    drawn = np.dstack([coefficients, rng.uniform(size=size), np.ones(size)])
    moves = placed(Shapes.over(seconds, 1000.0), drawn, limits)
    assert np.all((limits.lower - 1e-9 <= moves.q) & (moves.q <= limits.upper + 1e-9))
    assert np.all(np.abs(moves.dq) <= limits.speed * (1 + 1e-9))
    assert np.all(np.abs(moves.ddq) <= limits.acceleration * (1 + 1e-9))
    for at_ends in (moves.dq[:, [0, -1]], moves.ddq[:, [0, -1]]):
        assert np.abs(at_ends).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    "what",
    [
        "friction",
        "gravity",
        "imu-calib",
        "inertia",
        "payload",
        "validation",
        "discriminate",
    ],
)
@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    rig=st.sampled_from(list(BODIES)), spare=st.floats(1.3, 3.0), together=st.booleans()
)
def test_every_move_keeps_all_limits(
    what: What, rig: str, spare: float, together: bool
) -> None:
    imu = Imu("tool", 1, np.zeros((3, 3)), np.eye(3), gyro=True)
    robot = replace(sample_robot(rig), imus=(imu,))
    stages = Stages(inertia=inertia_stage(robot, BODIES[rig], error=0.01))
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.3))

    # Torque limits are those of moves of all joints; in some the arm only holds itself.
    moves = typical(belief, seed=1)
    busy = belief.torque(moves, belief.regressor(moves)).max(axis=(0, 1))
    limits = replace(belief.limits, torque=spare * busy)

    options = PlanOptions(
        duration_s=12.0,
        move_s=6.0,
        pool=16,
        sweeps=1,
        together=together,
        between=("stribeck", "quadratic_drag") if what == "discriminate" else (),
        joint=robot.joint_names[0],
        load_kg=1.0,
    )
    try:
        plan = make_plan(what, robot, limits, stages, options)
    except ConfigError as error:
        if "torque limit" not in str(error):
            raise
        reject()

    carrying = loaded(
        replace(belief, limits=limits), options.load_kg if what == "payload" else 0.0
    )
    assert plan.moves or what == "gravity"
    for move in plan.moves:
        used = limits_used(carrying, move)
        assert np.all(used <= 1 + ROUNDING * np.array([2, 1, 10, 10])), (
            move.name,
            used,
        )


def test_torque_limits_that_gravity_alone_breaks_are_told(belief: Belief) -> None:
    torque = belief.limits.torque.copy()
    torque[1] = 1e-3
    weak = replace(belief.limits, torque=torque)
    options = PlanOptions(duration_s=10.0, pool=60)
    for what in ("inertia", "friction"):
        with pytest.raises(ConfigError, match="shoulder_lift"):
            make_plan(what, belief.robot, weak, Stages(), options)


def test_the_tighter_limit_counts_and_none_is_left_is_told() -> None:
    robot = sample_robot("six_joint")
    limits = limits_of(robot, ramp_s=0.5, share=1.0)
    assert (limits.lower[1], limits.upper[1]) == pytest.approx((-2.7, 0.3))
    joints = list(robot.joints)
    joints[1] = replace(joints[1], position_limits=(-2.0, 1.0), velocity_limit=9.0)
    tighter = limits_of(replace(robot, joints=tuple(joints)), ramp_s=0.5, share=1.0)
    assert (tighter.lower[1], tighter.upper[1]) == pytest.approx((-2.0, 0.3))
    assert tighter.speed[1] == pytest.approx(2.2)
    assert tighter.acceleration[1] == pytest.approx(4.4)
    joints[1] = replace(joints[1], position_limits=(0.5, 1.0))
    with pytest.raises(ConfigError, match=r"shoulder_lift.*exclude each other"):
        limits_of(replace(robot, joints=tuple(joints)), ramp_s=0.5)


@pytest.mark.parametrize(("slides", "unit"), [(False, "(rad)"), (True, "(m)")])
def test_a_joint_without_limits_may_be_locked(slides: bool, unit: str) -> None:
    robot = sample_robot("two_joint")
    first, second = robot.joints
    tip = replace(second, name="tip", position_limits=None, prismatic=slides)
    robot = replace(robot, joints=(first, tip))
    with pytest.raises(ConfigError, match="'tip' has no position_limits") as caught:
        limits_of(robot, ramp_s=0.5)
    assert "--lock tip" in caught.value.hint
    assert unit in caught.value.hint
    limits = limits_of(robot, ramp_s=0.5, locked=["tip"])
    assert limits.moving == [0]
    with pytest.raises(UsageError, match="every joint is locked"):
        limits_of(robot, ramp_s=0.5, locked=robot.joint_names)
