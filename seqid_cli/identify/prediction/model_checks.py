"""A model that came in, held against physics: what no arm can be is said again.

`predict` and `diagnose` build on stages that may have been identified with another
robot file, or come from other hands.
"""

from seqid_cli.identify.friction_surface.checks import friction_verdicts
from seqid_cli.identify.rigid.gravity_checks import gravity_verdicts
from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.params.schema import Stages, Verdict
from seqid_cli.robot.types import Robot


def model_verdicts(
    stages: Stages, robot: Robot, settings: JudgingSettings = JudgingSettings()
) -> list[Verdict]:
    """Judge stages that a command builds on by the robot as it is now.

    Its gear ratios or its gravity may not be those of the identification. Each reason
    comes once per joint.
    """
    verdicts: list[Verdict] = []
    if stages.friction is not None:
        verdicts += friction_verdicts(stages.friction, robot, settings)
    if stages.gravity is not None:
        verdicts += gravity_verdicts(stages.gravity, stages.friction, robot, settings)
    if stages.inertia is not None:
        verdicts += inertia_verdicts(stages.inertia, stages.gravity, robot, settings)
    once = {(verdict.joint, verdict.reason): verdict for verdict in verdicts}
    return list(once.values())
