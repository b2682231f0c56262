"""Thresholds of discovery: each beside a case that it decides."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from seqid_cli.discover import diagnosis
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.selection import Selection
from seqid_cli.discover.settings import (
    DiscoverSettings,
    EventSettings,
    EvidenceSettings,
)
from seqid_cli.discover.survey import events
from seqid_cli.discover.survey.events import Interval
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.unit.thresholds.witness import Witness, witnesses


def unsure_effect(settings: EvidenceSettings, probability: float) -> bool:
    """Whether an effect that is there with this probability is not told."""
    asked: list[float] = []

    def all_taken(least: float) -> tuple[()]:
        asked.append(least)
        return ()

    found: Any = SimpleNamespace(
        model=SimpleNamespace(
            linear=SimpleNamespace(scores=lambda _: []),
            ground=SimpleNamespace(n=1, forget_search=lambda **_: None),
            terms=[],
        ),
        options=Options.of(settings),
        keys=set(),
        _last_tried=[],
        _search=SimpleNamespace(visible={}),
        _results_by_simplest=all_taken,
        _with_value_changes=lambda told, least: told,
        _name_at_joints=lambda: None,
    )
    Selection.told(found)
    return probability < asked[0]


def passes(settings: EvidenceSettings, evidence: float, share: float) -> bool:
    chosen: Any = SimpleNamespace(options=Options.of(settings))
    term: Any = SimpleNamespace(
        fit=SimpleNamespace(log_bayes_factor=evidence),
        score=SimpleNamespace(doubt=0.0, share=share),
    )
    return Selection._passes(chosen, term)


def noise(settings: EvidenceSettings, evidence: float) -> bool:
    return not passes(settings, evidence, share=0.9)


def negligible(settings: EvidenceSettings, share: float) -> bool:
    return not passes(settings, 1e6, share)


def invisible(settings: EvidenceSettings, share: float) -> bool:
    found: Any = SimpleNamespace(
        settings=DiscoverSettings(evidence=settings),
        selection=SimpleNamespace(visible_shares={("stribeck", 0): share}),
    )
    robot = load_robot(ROOT / "sample_logs" / "one_joint" / "robot.toml")
    return bool(diagnosis._hidden(found, robot))


def stands_out(settings: EventSettings, sigma: float) -> bool:
    """A window of this height among quiet ones; its certainty counts alike."""
    z = np.full((100, 1), 1.0)
    z[50] = sigma
    event = Interval(scene=0, start=0.0, end=1.0, joints=(0,), score=sigma)
    found = events._peaks(0, 0.3, z, 0.1 * np.arange(100.0), settings)
    assert bool(found) == (event.certainty(settings.min_sigma) > 0.5)
    return bool(found)


def lasts_too_long(settings: EventSettings, seconds: float) -> bool:
    """A stretch of this length that stands out, most in its middle."""
    centre = 0.05 * np.arange(1600.0)
    z = np.full((1600, 1), 1.0)
    z[np.abs(centre - 40.0) <= seconds / 2.0] = 20.0
    z[800] = 21.0
    return not events._peaks(0, 0.2, z, centre, settings)


def too_many(settings: EventSettings, count: float) -> bool:
    """So many events in a log of 20 s."""
    in_log = [
        Interval(scene=0, start=4.0 * k, end=4.0 * k + 0.5, joints=(0,), score=9.0)
        for k in range(round(count))
    ]
    track = SimpleNamespace(t=np.array([0.0, 20.0]))
    with patch.multiple(
        events,
        tracks_of=lambda *_: [track],
        standing_out=lambda *_: [in_log],
    ):
        rows: Any = None
        return not events.find_events(rows, [], settings)


WITNESSES = witnesses(
    "diagnose",
    [
        ("evidence.min_confidence", 0.6, 0.8, unsure_effect),
        ("evidence.min_log_evidence", 4.8, 7.2, noise),
        ("evidence.negligible_share", 0.032, 0.048, negligible),
        ("evidence.min_visible", 0.16, 0.24, invisible),
        ("events.min_sigma", 6.2, 4.2, stands_out),
        ("events.longest", 24.0, 16.0, lasts_too_long),
        ("events.most", 4, 3, too_many),
    ],
)


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda one: one.setting)
def test_a_threshold_lies_where_it_should(witness: Witness) -> None:
    witness.check()
