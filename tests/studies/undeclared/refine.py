"""What refinements are held against: a model that is told its effects and their
joints.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from seqid_cli.discover.candidates import candidates_of
from seqid_cli.discover.refinement.loop import with_effects
from seqid_cli.discover.refinement.reidentify import RefinementData, Refitted, refitted
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import FREE, HELD, Model, SelectionProblem
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.registry import CATALOGUE as EFFECTS
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import InputLog, ParameterFile, Stages
from seqid_cli.robot.types import Robot
from tests.studies.undeclared.cases import Truth

NEAR = 1.15  # of a model told the effects: that is as good


def file_of(
    robot: Robot, stages: Stages, logs: Mapping[str, Sequence[Recording]]
) -> ParameterFile:
    inputs = [
        InputLog(path=str(r.path), sha256=r.sha256, samples=len(r.t), stage=stage)
        for stage, recordings in logs.items()
        for r in recordings
    ]
    own = {name: getattr(stages, name) for name in ("friction", "gravity", "inertia")}
    return with_stage(None, robot_id(robot), inputs, **own)


def told_model(
    material: RefinementData, stages: Stages, truths: Sequence[Truth], *, late: bool
) -> Stages | None:
    """The model that is told its effects and their joints; None where they cannot be
    told.
    """
    if not truths or any(t.kind not in EFFECTS for t in truths):
        return None
    scenes = scenes_of(
        material.training, material.robot, stages, options=material.options.motion
    )
    rows = rows_of(scenes)
    model = Model(SelectionProblem.of(rows, stages), HELD if late else FREE)
    for truth in truths:
        names = material.robot.joint_names
        tuner = model.ground.tuner(model.linear)
        every = candidates_of(scenes, [EFFECTS[str(truth.kind)]], model.left())
        here = [
            c
            for c in every
            if (None if c.joint is None else names[c.joint]) in truth.joints
        ]
        tried = sorted(tuner.tried(here), key=lambda one: -one.evidence)
        if not tried:
            return None
        model.add([tuner.tuned(tried[0]).candidate])
    candidates = [replace(c, late=late) for c in model.candidates]
    start = Refitted(stages, ())
    return with_effects(
        refitted(material, start, candidates, kept=late), material.robot
    )
