"""What the friction of no arm can be: checks of the stage's result.

The stage's own verdicts judge its fit. Here its surfaces are held against physics:
friction takes energy away, and the gravity that was separated from it is of the size of
the URDF's.
"""

from collections.abc import Iterator

import numpy as np

from seqid_cli.identify.gravity_comparison import (
    gravity_of_trials,
    verdicts_by_nominal,
)
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionJoint, FrictionStage, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.typing import Array

# Positions, and speeds of a law over speed, at which a surface is looked at.
POSITIONS = 33
SPEEDS = 9


def friction_verdicts(
    stage: FrictionStage, robot: Robot, settings: JudgingSettings = JudgingSettings()
) -> Iterator[Verdict]:
    """Yield the joints whose friction drives, or whose gravity is not the URDF's."""
    for name, joint in stage.joints.items():
        reason = _driving(joint, settings)
        if reason:
            yield Verdict(joint=name, good=False, reason=reason)
    yield from verdicts_by_nominal(gravity_of_trials(stage, robot), robot, settings)


def _driving(joint: FrictionJoint, settings: JudgingSettings) -> str:
    """Say where friction would drive a joint instead of braking it, if it would."""
    surface = FrictionSurface.from_stage(joint)
    first, last = joint.position_range
    positions = np.linspace(first, last, POSITIONS)
    grid_q, grid_v = np.meshgrid(positions, _speeds(joint))
    q = grid_q.ravel()
    v = grid_v.ravel()

    # The mean of both directions: what is the same in both is an offset and takes no
    # energy.
    value = 0.5 * (surface.torque(q, v) - surface.torque(q, -v))
    error = 0.5 * (surface.std_error(q, v) + surface.std_error(q, -v))
    is_clear = value < -settings.clear_sigma * error
    drives = is_clear & (value < -settings.driving_share * rms(value))
    if np.mean(drives) <= settings.driving_cells:
        return ""

    worst = int(np.argmin(np.where(drives, value, np.inf)))
    return (
        f"its friction is {value[worst]:.3g} +- {error[worst]:.2g} {joint.unit}"
        f" at {v[worst]:.3g} per second: it would drive the joint. The sign of"
        " torque or current is wrong, or it is another joint's"
    )


def _speeds(joint: FrictionJoint) -> Array:
    """Return the speeds at which a joint's friction is looked at."""
    slowest, fastest = joint.speed_range
    if joint.parameters:  # a law over speed, of one level alone
        return np.linspace(max(slowest, 3.0 * joint.sign_width), fastest, SPEEDS)
    speeds = [level.speed for level in joint.speeds if level.speed > joint.sign_width]
    return np.array(speeds or [fastest])
