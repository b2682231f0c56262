"""What gravity can not be: checks of the gravity stage's result.

It is held against the gravity that the friction stage separated from its own trials,
trial by trial, and against that of the URDF's inertials.
"""

from collections.abc import Iterator

from seqid_cli.identify.gravity_comparison import (
    gravity_of_stage,
    gravity_of_trials,
    verdicts_by_nominal,
    verdicts_by_stage,
)
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.params.schema import FrictionStage, RigidStage, Verdict
from seqid_cli.robot.types import Robot

IN_TRIALS = (
    "gravity in the friction trials (Eq. 12-15) is not that of the parameters: {} are"
    " left, it is {:.2g} times that. Check unit and sign of the torque, the direction"
    " of gravity and the order of the joints"
)


def gravity_verdicts(
    stage: RigidStage,
    friction: FrictionStage | None,
    robot: Robot,
    settings: JudgingSettings = JudgingSettings(),
) -> Iterator[Verdict]:
    """Yield the joints whose gravity is not that of friction's trials or the URDF's."""
    if not stage.parameters:
        return
    if friction is not None:
        trials = gravity_of_trials(friction, robot)
        yield from verdicts_by_stage(trials, robot, stage, IN_TRIALS, settings)
    yield from verdicts_by_nominal(gravity_of_stage(stage, robot), robot, settings)
