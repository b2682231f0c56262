"""A plant with an effect outside the catalogue: unexplained, and named once it is a
formula.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.robot.formula import parse_formula
from seqid_cli.robot.types import OwnEffect
from tests.plants.effects.friction import clear
from tests.studies.undeclared.cases import declared, outside
from tests.studies.undeclared.logs import logs_of, stages_of

pytestmark = pytest.mark.slow

STUDIED = next(
    case
    for case in outside()
    if (case.rig, case.effects[0][0], case.seed)
    == ("two", "outside.acceleration_cube", 0)
)
CASE = replace(STUDIED, seconds=11.0)  # the study's own logs are longer
ELBOW = 1


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("own")


def diagnosed(cache: Path, *own: OwnEffect) -> DiagnosisFile:
    recorded = logs_of(CASE, cache)
    robot = replace(recorded.robot, effects=own)
    stages = stages_of(CASE, cache)
    return diagnose(list(recorded.training), robot, stages, options=DiscoverOptions())


def test_without_it_the_part_is_unexplained(cache: Path) -> None:
    found = diagnosed(cache)
    assert not found.findings
    (part,) = found.unexplained
    assert (part.joint, part.depends_on) == ("elbow", ["acceleration"])


def test_with_it_the_effect_is_named_at_its_joint_with_its_size(cache: Path) -> None:
    plant = declared(CASE)
    top = 0.7 * float(plant.acceleration_limits[ELBOW])
    text = f"c1 * max(min(ddq / {top}, 1), -1) ** 3"
    found = diagnosed(cache, OwnEffect("demagnetising", None, parse_formula(text, 2)))
    (finding,) = found.findings
    assert (finding.effect, finding.joint) == ("demagnetising", "elbow")
    assert finding.confidence > 0.8
    (c1,) = finding.parameters
    assert c1.value == pytest.approx(clear(plant, ELBOW, CASE.effects[0][2]), rel=0.1)
    assert not found.unexplained
