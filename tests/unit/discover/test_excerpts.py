"""Logs too long to be held: what is found of them in pieces, and that nothing is
overlooked.
"""

import gc
import tracemalloc
from concurrent.futures import Executor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.discover import excerpts
from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.excerpts import Excerpts, one_each, take_excerpts
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.settings import EventSettings
from seqid_cli.discover.survey.events import Interval
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.logs.long import open_long
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.scale import processes
from tests.unit.discover.long_logs import BEGUN, MOST, LongCase, long_case

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning"),
]

OPTIONS = DiscoverOptions()
PUSHED = 66.0  # s, in no piece of the clean log


@pytest.fixture(autouse=True)
def _passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(excerpts, "PASSED_OVER", 1000)


def diagnosed(case: LongCase, pieces: Excerpts) -> DiagnosisFile:
    return diagnose(pieces.recordings, case.robot, case.stages, options=OPTIONS)


@cache
def clean_pieces(folder: Path) -> Excerpts:
    return long_case().pieces(folder / "clean.parquet")


@cache
def clean_diagnosis(folder: Path) -> DiagnosisFile:
    return diagnosed(long_case(), clean_pieces(folder))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("long")


def test_pieces_are_of_the_log_with_its_stamps(folder: Path) -> None:
    case, pieces = long_case(), clean_pieces(folder)
    assert len(pieces.recordings) == 2
    assert (
        sum(len(x.t) for x in pieces.recordings) * (2 + 2 + 0.36 * 24) * (1 + 350 / 500)
        <= MOST
    )
    for piece in pieces.recordings:
        assert piece.source_log.start == pytest.approx(BEGUN)
        first = round(piece.offset * case.log.rate_hz)
        part = slice(first, first + len(piece.t))
        np.testing.assert_array_equal(piece.q, case.log.q[part])
        np.testing.assert_array_equal(piece.tau, case.log.tau[part])
        assert piece.start == pytest.approx(BEGUN + case.log.t[first], abs=1e-6)
    assert len({x.sha256 for x in pieces.recordings}) == 2
    assert len(one_each(pieces)) == 1


def test_where_nothing_is_missing_notes_say_what_was_looked_at(folder: Path) -> None:
    found = clean_diagnosis(folder)
    assert (found.verdict, found.events) == ("nothing_missing", [])
    case, pieces = long_case(), clean_pieces(folder)
    first, residual, *others = pieces.notes(case.robot)
    assert "of 72 s 40 s were looked at, in 2 pieces" in first
    (log,) = predict([case.log], case.robot, case.stages, options=InertiaOptions())
    counts = log.used[:, None] & log.sliding
    left = np.where(counts, log.tau - log.predicted, 0.0)
    rms = np.sqrt(np.sum(left**2, axis=0) / counts.sum(axis=0))
    (survey,) = pieces.surveys
    seen = np.sqrt(survey.squares.sum(axis=0) / survey.counts.sum(axis=0))
    np.testing.assert_allclose(seen, rms, rtol=1e-7)
    assert residual.endswith(f"shoulder {rms[0]:.3g} N m, elbow {rms[1]:.3g} N m")
    assert not others


def test_a_push_outside_the_pieces_is_found(folder: Path) -> None:
    case = long_case()
    case = case.with_torque(
        np.outer(np.exp(-(((case.log.t - PUSHED) / 0.1) ** 2)), [4.0, 1.5])
    )
    pieces = case.pieces(folder / "pushed.parquet")
    same = [x.offset for x in clean_pieces(folder).recordings]
    others = [x.offset for x in pieces.recordings]
    assert [x for x in others if x in same] == same  # the residual has no say in them
    assert not any(x <= PUSHED <= x + 20.0 for x in same)
    assert pieces.about_places == len(others) - len(same) == 1
    found = diagnosed(case, pieces)
    (event,) = found.events
    assert event.start < PUSHED < event.end < event.start + 1.0
    assert event.log == str(folder / "pushed.parquet")
    assert [f.effect for f in found.findings] == ["external_contact"]
    assert found.findings[0].confidence > 0.5
    for name, joint in clean_diagnosis(folder).joints.items():
        assert found.joints[name].rmse == pytest.approx(joint.rmse, rel=0.2)


def test_what_stands_out_is_a_setting_in_worker_processes_too(folder: Path) -> None:
    case = long_case()
    push = np.exp(-(((case.log.t - PUSHED) / 0.1) ** 2))
    case = case.with_torque(np.outer(push, [4.0, 1.5]))
    path = case.written(folder / "pushed_again.parquet")

    def places(
        settings: EventSettings, executor: Executor | None
    ) -> tuple[Interval, ...]:
        (survey,) = take_excerpts(
            LogSet(logs=[path], robot=case.robot, executor=executor),
            case.robot,
            case.stages,
            options=OPTIONS.motion,
            settings=settings,
            most_values=MOST,
        ).surveys
        return survey.places

    both = (EventSettings(), EventSettings(longest=0.1))
    here = [places(settings, None) for settings in both]
    with processes(2) as executor:
        there = [places(settings, executor) for settings in both]
    assert any(place.start < PUSHED < place.end for place in here[0])
    assert not any(place.start < PUSHED < place.end for place in here[1])
    assert there == here


def test_a_slow_drift_is_found(folder: Path) -> None:
    case = long_case()
    case = case.with_torque(np.outer(case.log.t / case.log.t[-1], [0.6, 0.0]))
    pieces = case.pieces(folder / "drifting.parquet")
    found = diagnosed(case, pieces)
    first = found.findings[0]
    assert (first.effect, first.joint) == ("drift", "shoulder")
    rate = next(p for p in first.parameters if p.name == "rate")
    assert rate.value == pytest.approx(0.6 / float(case.log.t[-1]), rel=0.1)
    assert any(
        "shoulder in tenths of the time" in note for note in pieces.notes(case.robot)
    )


def test_a_log_that_is_at_hand_is_cut_alike(folder: Path) -> None:
    case, pieces = long_case(), clean_pieces(folder)
    options = OPTIONS.motion
    held = take_excerpts(
        [case.log], case.robot, case.stages, options=options, most_values=MOST
    )
    for one, other in zip(held.recordings, pieces.recordings, strict=True):
        assert one.offset == pytest.approx(other.offset, abs=1e-9)
        np.testing.assert_array_equal(one.q, other.q)


def test_memory_of_the_pass_does_not_grow_with_the_log(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bytes at the worst moment, of the same log three and nine times over."""
    monkeypatch.setattr(excerpts, "SPAN", 500)
    case, log, peaks = long_case(), long_case().log, []
    known = {"robot": case.robot, "stages": case.stages, "options": InertiaOptions()}
    for times in (3, 9):
        q, tau = (np.tile(x, (times, 1)) for x in (log.q, log.tau))
        repeated = replace(log, t=np.arange(len(q)) / log.rate_hz, q=q, tau=tau)
        path = replace(case, log=repeated).written(folder / f"{times}.parquet")
        del q, tau, repeated
        surveyed = open_long(path, case.robot)
        gc.collect()
        tracemalloc.start()
        excerpts.residual_survey(surveyed, **known)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.15 * peaks[0]
