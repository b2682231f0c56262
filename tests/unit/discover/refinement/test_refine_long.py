"""Refinement on logs that are too long to be held: fitted in pieces, judged as a whole."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.discover.excerpts import excerpts
from seqid_cli.discover.excerpts.excerpts import Excerpts, take_excerpts
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement import held_out as heldout
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.held_out import WholeLogs, held_out_error
from seqid_cli.discover.refinement.rounds import on_the_same_samples, refine
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.prediction.predict import LongPrediction
from seqid_cli.logs.read import read_recording
from seqid_cli.motion import blocks
from seqid_cli.params.schema import ClosedLoop, Stages
from tests.unit.discover.long_logs import LongCase, long_case

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")]
OPTIONS = DiscoverOptions(max_effects=1)
MOST = 429_760
HUMP = ("stribeck", 1, 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("long")


@pytest.fixture(autouse=True)
def _passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(excerpts, "PASSED_OVER", 1000)
    monkeypatch.setattr(heldout, "LONG", 1000)
    monkeypatch.setattr(LongPrediction, "rows", 7_000)
    monkeypatch.setattr(blocks, "LEAST_BLOCK", 9_000)


def cases() -> tuple[LongCase, LongCase]:
    """What is fitted, and what is held out: other motions."""
    return long_case(HUMP), long_case(HUMP, seed=11)


def pieces(case: LongCase, path: Path) -> Excerpts:
    files = LogSet([case.written(path)], case.robot)
    return take_excerpts(
        files,
        case.robot,
        case.stages,
        options=OPTIONS.motion,
        most_values=MOST,
        places=False,
    )


@cache
def refined(folder: Path) -> tuple[Stages, ClosedLoop]:
    training, unseen = cases()
    fitted = pieces(training, folder / "fitted.parquet")
    held = pieces(unseen, folder / "held.parquet")
    assert len(fitted.recordings) == 2
    assert held.surveys
    whole = WholeLogs((folder / "held.parquet",), training.robot)
    found = refine(fitted.recordings, training.robot, training.file, earlier={}, options=OPTIONS)
    return found.stages, confirm(found, held.recordings, whole)


def test_the_effect_is_added(folder: Path) -> None:
    stages, loop = refined(folder)
    (told,) = [r for r in loop.rounds if r.accepted]
    assert (told.effect, told.joint) == ("stribeck", "elbow")
    assert stages.effects is not None
    assert [x.effect for x in stages.effects] == ["stribeck"]
    assert loop.after["elbow"].rmse < 0.5 * loop.before["elbow"].rmse


def test_errors_are_of_the_whole_log(folder: Path) -> None:
    stages, loop = refined(folder)
    training, _ = cases()
    log = read_recording(folder / "held.parquet", training.robot)
    robot, file = training.robot, training.file
    motion = on_the_same_samples(OPTIONS, file.stages, robot).motion
    before = held_out_error([log], robot, file.stages, options=motion)
    after = held_out_error([log], robot, stages, options=motion)
    for told, error in ((loop.before, before), (loop.after, after)):
        np.testing.assert_allclose([x.rmse for x in told.values()], error.rmse(), rtol=1e-8)
    assert loop.evaluated_on == [str(folder / "held.parquet")]
    assert any("errors are of the whole held-out logs" in note for note in loop.notes)
