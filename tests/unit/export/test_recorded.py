"""Recorded robots: what is written of a refined model is as good as the model."""

from pathlib import Path
from typing import NamedTuple

import pytest

from seqid_cli.discover.functions import refine
from seqid_cli.export import export
from seqid_cli.export.written.code import compiler
from seqid_cli.identify.functions import simultaneous
from seqid_cli.params.results.export import ExportFile
from tests.unit.effects.few import only_effects
from tests.unit.export.recordings import DATA, EFFECTS, ROBOTS, TESTED

pytestmark = pytest.mark.slow


class Refined(NamedTuple):
    """Parameter files of one robot, before and after refinement, and what they were
    made of.
    """

    robot: Path
    before: Path
    after: Path
    held_out: Path


@pytest.fixture(scope="module", params=TESTED)
def refined(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Refined:
    source = DATA / request.param
    if not source.is_dir():
        pytest.skip(f"the recorded data of {request.param} are not beside the project")
    folder = tmp_path_factory.mktemp(request.param)
    training, held_out = ROBOTS[request.param]
    logs = [source / name for name in training]
    robot, before, after = (
        source / "robot.toml",
        folder / "before.json",
        folder / "after.json",
    )
    simultaneous(logs, robot, output=before)
    with only_effects(EFFECTS):
        refine(logs, source / held_out, robot, before, output=after)
    return Refined(robot, before, after, source / held_out)


def errors(file: ExportFile) -> dict[str, float]:
    assert file.replay is not None
    return {
        name: joint.export_rmse or 0.0 for name, joint in file.replay.joints.items()
    }


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_exported_code_is_as_good_as_the_refined_file(
    refined: Refined, tmp_path: Path
) -> None:
    done = export(refined.after, refined.robot, tmp_path / "arm.h")
    assert done.replay is not None
    assert done.replay.passed, done.replay.failures


@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_a_refined_model_file_is_no_worse_than_the_unrefined(
    refined: Refined, tmp_path: Path, suffix: str
) -> None:
    """But for a thousandth or two, by which a joint is kept where it was."""
    if Path(refined.robot).parent.name == "ur10e_innopolis":
        pytest.xfail("the file's delays were found beside effects that no URDF has")
    target = tmp_path / f"arm.{suffix}"
    old = errors(
        export(refined.before, refined.robot, target, replay=[refined.held_out])
    )
    new = errors(export(refined.after, refined.robot, target))
    for name, error in new.items():
        assert error <= 1.002 * old[name], name
