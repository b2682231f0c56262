"""What is shown of a finding: rows of a joint that feels it."""

from typing import cast

import numpy as np

from seqid_cli.discover.evidence import evidence_of
from seqid_cli.discover.investigate import FileResidual, Investigation
from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from tests.unit.discover.arms import file_of, measuring, selected
from tests.unit.effects.scenes import scene_of, wander

ZERO_RAD = 0.2


def with_a_joint_that_stands_still(log: int) -> Scene:
    """The second joint moves; the first one's zero is wrong, which the second feels."""
    rng = np.random.default_rng(log)
    scene = scene_of(
        wander(16.0, seed=log, rests=(), still=[0]),
        log=log,
        start=40.0 * log,
        shared_clock=True,
    )
    columns = CATALOGUE["joint_zero"].columns(scene, 0, {"around": 0.0})
    tau = scene.modelled + 0.05 * rng.normal(size=scene.motion.q.shape)
    tau[:, 1] += ZERO_RAD * columns[1][:, 0]
    return measuring(scene, tau)


def test_a_finding_at_a_joint_that_stands_still_is_shown_where_it_is_felt() -> None:
    scenes = [with_a_joint_that_stands_still(log) for log in range(3)]
    found = selected(scenes, ["joint_zero"], stages=file_of(scenes[0]))
    assert [result.term.key for result in found.terms] == [("joint_zero", 0)]
    investigation = Investigation(
        logs=(),
        selection=found,
        floor=cast(NoiseFloor, None),
        events=(),
        file_residual=cast(FileResidual, None),
        settings=DiscoverSettings(),
    )
    shown = evidence_of(investigation, scenes[0].robot, found.terms[0])
    assert shown.joint == scenes[0].robot.joint_names[1]
    assert np.std(shown.after) < 0.3 * np.std(shown.before)
