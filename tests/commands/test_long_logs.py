"""What `refine` reads of earlier stages whose logs are too long to be held."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.discover.excerpts import excerpts
from seqid_cli.discover.excerpts.excerpts import Excerpts, take_excerpts
from seqid_cli.discover.refinement import earlier_logs
from seqid_cli.discover.refinement.earlier_logs import read_earlier
from seqid_cli.discover.refinement.log_sets import EarlierLogs
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions, LogOptions
from seqid_cli.logs.read import read_recording
from tests.unit.discover.long_logs import LongCase, long_case

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")]

MOST = 429_760


@pytest.fixture(autouse=True)
def _passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(excerpts, "PASSED_OVER", 1000)
    defaults = take_excerpts.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "most_values", MOST)


def inputs_of(case: LongCase, folder: Path) -> Inputs:
    file, log = case.file, folder / "fitted.parquet"
    return Inputs((log,), case.robot, (("model", file),), file, (), None, LogOptions())


def fitted_and_found(case: LongCase, folder: Path) -> tuple[Excerpts, EarlierLogs]:
    """The fitted log is of the inertia stage and, like another one, of the friction stage."""
    paths = [case.written(folder / f"{name}.parquet") for name in ("fitted", "other")]
    other = case.with_torque(lambda t: np.full((len(t), 2), 0.1)).written(paths[1])
    fitted = take_excerpts(
        LogSet(paths[:1], case.robot),
        case.robot,
        case.stages,
        options=InertiaOptions(),
        places=False,
    )
    digests = [read_recording(path, case.robot).sha256 for path in (paths[0], other)]
    found = EarlierLogs(
        dict(zip(digests, paths, strict=True)), {"friction": digests, "inertia": digests}, ()
    )
    return fitted, found


def test_trials_beyond_what_is_held_are_left_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(earlier_logs, "MOST_OF_TRIALS", 68_000)
    case = long_case()
    fitted, found = fitted_and_found(case, tmp_path)
    earlier = read_earlier(inputs_of(case, tmp_path), found, fitted, InertiaOptions())
    assert list(earlier.by_stage["friction"]) == []
    assert list(earlier.by_stage["inertia"]) == list(fitted.recordings)
    (note,) = earlier.notes
    assert note.startswith("the 2 logs of earlier stages are too long")
