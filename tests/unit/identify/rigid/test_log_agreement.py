"""A log, or a stretch of one, whose rigid body is not that of the others stands out by
name.
"""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.identify.rigid.log_agreement import agreement_verdicts, log_equations
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Verdict
from seqid_cli.robot.regressor import inverse_dynamics
from tests import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.motions.trajectories import fourier
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import arm_6r, planar_2r

RATE = 100.0
COULOMB = np.array([4.0, 3.5, 3.0, 1.5, 1.0, 0.8])
TOOL = np.zeros((6, 10))
TOOL[5] = [1.0, 0.0, 0.0, 0.1, 0.011, 0.0, 0.011, 0.0, 0.0, 0.001]  # 1 kg, 0.1 m out


def log(seed: int, load: Array, *, stribeck: float = 0.0) -> Recording:
    """One Fourier series of the six-joint arm; `load` (N or 1,) says when it has the
    tool.
    """
    rng = np.random.default_rng(seed)
    end, top = np.full(6, 2.0), np.full(6, 2.0)
    motion = fourier(
        rng, -end, end, top, 4 * top, seconds=30.0, harmonics=15, rate_hz=RATE
    )
    arm, state = arm_6r(), (motion.q, motion.dq, motion.ddq)
    plain, loaded = (
        inverse_dynamics(arm.chain, arm.gravity, six_joint().arm.phi + part, *state)
        for part in (0.0 * TOOL, TOOL)
    )
    tau = np.where(load[:, None], loaded, plain)
    tau += (
        COULOMB
        * np.sign(motion.dq)
        * (1.0 + stribeck * np.exp(-np.abs(motion.dq) / 0.1))
    )
    tau += motion.dq + 0.1 * rng.standard_normal(tau.shape)
    return made_recording(motion.q, tau, rate_hz=RATE, path=f"log_{seed}")


def verdicts(*logs: Recording) -> list[Verdict]:
    plain = arm_6r()
    joints = tuple(replace(joint, rotor_inertia=0.0) for joint in plain.joints)
    robot = replace(plain, joints=joints)
    _, stage = identify_simultaneous(logs, robot, options=MotionOptions(6.0))
    return [verdict for verdict in stage.verdicts if "differ" in verdict.reason]


WITH, WITHOUT = np.array([True]), np.array([False])
HALF = np.arange(round(30.0 * RATE)) >= 15.0 * RATE


def test_a_tool_in_one_of_three_logs() -> None:
    (found,) = verdicts(log(1, WITHOUT), log(2, WITHOUT), log(3, WITH))
    assert found.reason.startswith(
        "log_3 differs from the others: one rigid body for all leaves"
    )
    assert (found.good, found.level) == (False, "poor")
    assert "seqid diagnose" in found.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loads", "named"),
    [
        ((WITHOUT, WITH), "differs from log_"),
        (
            (WITHOUT, WITH, WITHOUT, WITH, WITHOUT),
            "log_1, log_3 differ from the others",
        ),
        ((HALF,), "log_0 (part 1 of 4, part 2 of 4) differs from the rest of the log"),
        ((WITHOUT, HALF), "log_1 (part 3 of 4, part 4 of 4) differs from the others"),
    ],
)
def test_tools_that_come_and_go(loads: tuple[Array, ...], named: str) -> None:
    (found,) = verdicts(*(log(k, load) for k, load in enumerate(loads)))
    assert named in found.reason


@pytest.mark.parametrize("stribeck", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_logs_of_one_arm_agree_also_where_the_law_is_wrong(stribeck: float) -> None:
    logs = [log(seed, WITHOUT, stribeck=stribeck) for seed in (1, 2, 3)]
    assert verdicts(*logs) == []
    assert verdicts(logs[0]) == []


def test_friction_may_differ_and_few_rows_say_nothing() -> None:
    """Only the first parameters are the rigid body's;
    chance parts short logs as well.
    """
    rng = np.random.default_rng(0)
    robot = planar_2r()

    def equations(body: float, friction: float, rows: int) -> list[Accumulator]:
        joints = []
        for _ in range(robot.n):
            joint, H = Accumulator(2), rng.standard_normal((rows, 2))
            joint.add(H, H @ [body, friction] + 0.1 * rng.standard_normal(rows))
            joints.append(joint)
        return joints

    def told(*logs: tuple[float, float], rows: int = 400) -> list[Verdict]:
        joints = [equations(*log, rows) for log in logs]
        names = [f"{k}.csv" for k in range(len(logs))]
        squares = np.full(robot.n, 2.0 * rows * len(logs))
        sigma = np.full(robot.n, 0.1)
        return agreement_verdicts(
            log_equations(names, joints), robot, sigma, squares, 1
        )

    (odd,) = told((1, 1), (1, 1), (1.6, 1))
    assert odd.reason.startswith("2.csv differs from the others")
    assert told((1, 1), (1, 1), (1, 1)) == []
    assert told((1, 1), (1, 1), (1, 1), rows=3) == []
    # no log stands out: the model is wrong
    assert told((1, 1), (2, 1), (3, 1), (4, 1)) == []
