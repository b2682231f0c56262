"""The delay in the file is the one that the rigid body was found beside."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from seqid_cli.identify.nuisances import term_of, with_term
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from tests.plants.robots.identified import held_out
from tests.plants.robots.sample import Rig

MISREAD_S = 4e-3  # as friction trials know a delay: to milliseconds


def with_waves(log: Recording, share: float) -> Recording:
    """A log with torque over the position of the first joint that no stage has."""
    assert log.tau is not None
    tau = log.tau.copy()
    tau[:, 0] += share * np.std(tau[:, 0]) * np.sin(4.0 * log.q[:, 0])
    return replace(log, tau=tau)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.2], ids=["good", "something is missing"])
def test_a_file_predicts_its_own_logs_as_its_stage_says(
    two_joint: Rig, share: float
) -> None:
    name = two_joint.robot.joint_names[0]
    friction = two_joint.friction
    misread = with_term(friction.joints[name], "delay", MISREAD_S, MISREAD_S)
    joints = {**friction.joints, name: misread}
    stages = Stages(
        friction=msgspec.structs.replace(friction, joints=joints),
        gravity=two_joint.gravity,
    )
    logs = [with_waves(log, share) for log in two_joint.logs("inertia")]

    result = identify_inertia(logs, two_joint.robot, stages, options=InertiaOptions())
    by_joint = {verdict.joint: verdict for verdict in result.inertia.verdicts}
    assert by_joint[name].good == (share == 0.0)

    delay = term_of(result.friction.joints[name], "delay")
    assert delay is not None
    assert abs(delay.value) < 0.1 * MISREAD_S
    file = msgspec.structs.replace(
        stages, friction=result.friction, inertia=result.inertia
    )
    predicted = held_out(logs, two_joint.robot, file, InertiaOptions())
    assert predicted.sliding[0] < 1.1 * result.inertia.rmse[name]


def late(log: Recording, seconds: float) -> Recording:
    """A log whose torques are late against its positions."""
    assert log.tau is not None
    tau = [np.interp(log.t - seconds, log.t, column) for column in log.tau.T]
    return replace(log, tau=np.stack(tau, axis=1))


def test_one_step_predicts_torque_as_late_as_it_is(two_joint: Rig) -> None:
    robot = two_joint.robot
    logs = [late(log, MISREAD_S) for log in two_joint.logs("inertia")]

    friction, inertia = identify_simultaneous(logs, robot, options=MotionOptions())
    file = Stages(friction=friction, inertia=inertia)
    for name in robot.joint_names:
        delay = term_of(friction.joints[name], "delay")
        assert delay is not None
        # Beside Coulomb and viscous friction it takes what friction is otherwise.
        assert delay.value == pytest.approx(MISREAD_S, rel=0.3)
    predicted = held_out(logs, robot, file, InertiaOptions())
    for sliding, rmse in zip(predicted.sliding, inertia.rmse.values(), strict=True):
        assert sliding < 1.1 * rmse
