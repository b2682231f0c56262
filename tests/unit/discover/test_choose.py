"""Pieces of long logs: how many, where, and that they are varied."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.excerpts.design import MOST_PIECES, PIECE_S, chosen
from seqid_cli.discover.excerpts.excerpts import ASIDE_S, INNER_S, MOST_ASIDE, about_places
from seqid_cli.discover.excerpts.residual_survey import BLOCK_S, LOOKS_PER_S, LookedOver
from seqid_cli.discover.survey.events import Interval
from seqid_cli.logs.recording import Whole

Array = NDArray[np.float64]
RATE = 500.0


def look(
    seconds: float,
    *,
    speed: Array | None = None,
    usable: NDArray[np.bool_] | None = None,
    places: tuple[Interval, ...] = (),
) -> LookedOver:
    """One joint that swings to and fro, at a speed of its own in each look; 2 rad/s by default."""
    t = np.arange(0.0, seconds, 1.0 / LOOKS_PER_S)
    size = np.full(len(t), 2.0) if speed is None else speed
    dq = (size * np.where(np.sin(2 * np.pi * t / 3.0) > 0, 1.0, -1.0))[:, None]
    blocks = int(seconds / BLOCK_S) + 1
    return LookedOver(
        path=Path("log"),
        whole=Whole("0" * 64, 0.0, seconds),
        samples=int(seconds * RATE),
        rate_hz=RATE,
        kind="",
        squares=np.ones((blocks, 1)),
        counts=np.ones((blocks, 1)),
        t=t,
        q=np.sin(dq).astype(np.float32),
        dq=dq.astype(np.float32),
        slides=np.ones((len(t), 1), dtype=bool),
        usable=np.ones(len(t), dtype=bool) if usable is None else usable,
        places=places,
    )


@pytest.mark.parametrize(("seconds", "held"), [(600.0, 140.0), (3600.0, 140.0), (200.0, 143.0)])
def test_pieces_fill_what_may_be_held_and_reach_over_the_time(seconds: float, held: float) -> None:
    (pieces,) = chosen([look(seconds)], held * RATE)
    assert sum(b - a for a, b in pieces) == pytest.approx(held, rel=1e-9)
    assert len(pieces) == round(held / PIECE_S)
    assert all(b <= c for (_, b), (c, _) in pairwise(pieces))
    assert pieces[0][1] <= seconds / len(pieces) + 1e-9
    assert pieces[-1][0] >= seconds * (1 - 1 / len(pieces)) - 1e-9


def test_slow_logs_have_longer_pieces() -> None:
    (pieces,) = chosen([look(7200.0)], 1800.0 * RATE)
    assert len(pieces) == MOST_PIECES
    assert sum(b - a for a, b in pieces) == pytest.approx(1800.0)


def test_what_fits_is_taken_whole() -> None:
    assert chosen([look(100.0), look(50.0)], 150.0 * RATE) == [[(0.0, 100.0)], [(0.0, 50.0)]]


def test_motion_that_is_new_is_taken() -> None:
    seconds = 900.0
    speed = np.full(int(seconds * LOOKS_PER_S), 0.2)
    odd = slice(int(500.0 * LOOKS_PER_S), int(524.0 * LOOKS_PER_S))
    speed[odd] = 2.0
    (pieces,) = chosen([look(seconds, speed=speed)], 60.0 * RATE)
    assert any(a >= 498.0 and b <= 526.0 for a, b in pieces)


def test_every_log_has_its_part_and_a_gap_has_none() -> None:
    usable = np.ones(6000, dtype=bool)
    usable[1000:3000] = False
    logs = [look(600.0, usable=usable), look(60.0), look(60.0)]
    pieces = chosen(logs, 120.0 * RATE)
    assert all(pieces)
    assert all(b <= 102.0 or a >= 298.0 for a, b in pieces[0])
    assert sum(b - a for some in pieces for a, b in some) <= 121.0


def test_places_that_stand_out_are_looked_at_aside() -> None:
    inside, outside = (Interval(0, at, at + 0.3, (0,), 9.0) for at in (50.0, 300.0))
    at_edge = Interval(0, 42.0, 42.2, (0,), 7.0)
    logs = [look(600.0, places=(inside, outside, at_edge))]
    ((first, second),) = about_places(logs, [[(41.5, 61.5)]])
    assert first == (300.0 - ASIDE_S, 300.3 + ASIDE_S)
    assert second[0] + INNER_S < at_edge.start < second[1]


def test_the_strongest_places_come_first() -> None:
    many = [Interval(0, 20.0 * k, 20.0 * k + 0.2, (0,), float(k)) for k in range(1, 20)]
    pieces = about_places([look(600.0, places=tuple(many[:9])), look(600.0)], [[], []])
    assert len(pieces[0]) == MOST_ASIDE
    assert [round(a + ASIDE_S) for a, _ in pieces[0]] == [20 * k for k in range(9, 3, -1)]
