"""Predictions with the effects of a parameter file."""

import numpy as np
import pytest

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, predict
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectOfJoint, FrictionStage, Stages
from tests.plants.robots.made import friction_joint, made_recording
from tests.plants.robots.two_joint import COULOMB, SIGN_WIDTH, VISCOUS, two_joint_robot
from tests.unit.model.effects.scenes import CUTOFF_HZ, RATE_HZ, wander

ROBOT = two_joint_robot()
TOP = 4.0
HUMP, SPEED = 1.0, 0.3
STRIBECK = EffectOfJoint(
    effect="stribeck",
    joint="joint_1",
    settings={"stribeck_speed": SPEED, "exponent": 2.0},
    coefficients=[HUMP],
)


def friction() -> FrictionStage:
    joints = {}
    for name, coulomb, viscous in zip(ROBOT.joint_names, COULOMB, VISCOUS, strict=True):
        half = 0.5 * viscous * TOP
        joints[name] = friction_joint(
            [[coulomb + half, half]], speed_range=[0.0, TOP], sign_width=SIGN_WIDTH
        )
    return FrictionStage(joints=joints)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Friction with a hump and an offset; at rest the first joint holds all that it can."""
    q = wander(20.0, seed=2)
    dq = np.gradient(q, 1.0 / RATE_HZ, axis=0)
    s = np.tanh(dq / SIGN_WIDTH)
    hump = np.exp(-((dq[:, 0] / SPEED) ** 2))
    tau = s * np.array(COULOMB) + np.array(VISCOUS) * dq
    tau += np.column_stack([hump * s[:, 0], np.full(len(q), 0.4)])
    t = np.arange(len(q)) / RATE_HZ
    resting = (t > 5.3) & (t < 6.7)
    tau[resting, 0] = COULOMB[0] + 0.95 * HUMP
    return made_recording(q, tau, rate_hz=RATE_HZ)


def predicted(recording: Recording, *effects: EffectOfJoint) -> LogPrediction:
    stages = Stages(friction=friction(), effects=list(effects) or None)
    options = InertiaOptions(motion=MotionOptions(cutoff_hz=CUTOFF_HZ))
    (log,) = predict([recording], ROBOT, stages, options=options)
    return log


def test_rest_holds_what_the_effects_allow(recording: Recording) -> None:
    """Above the friction surface, within it and the hump: no error once the hump is known."""
    without, with_hump = predicted(recording), predicted(recording, STRIBECK)
    still = (recording.t > 5.6) & (recording.t < 6.4)
    assert not without.sliding[still, 0].any()
    np.testing.assert_allclose(without.beyond[still, 0], 0.95 * HUMP, atol=0.15)
    np.testing.assert_allclose(with_hump.beyond[still, 0], 0.0, atol=1e-6)
