"""Pieces of long logs: how many, where, and that they are varied."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.discover.excerpts import PIECE_S, ResidualSurvey, excerpts_of
from seqid_cli.discover.survey.repeats import BLOCK_S
from seqid_cli.logs.recording import Whole
from tests import Array

RATE = 500.0


def survey(
    seconds: float, *, speed: Array | None = None, usable: Array | None = None
) -> ResidualSurvey:
    """One joint that swings to and fro, at a speed of its own in each block; 2 rad/s by
    default.
    """
    blocks = int(seconds / BLOCK_S) + 1
    size = np.full(blocks, 2.0) if speed is None else speed
    return ResidualSurvey(
        path=Path("log"),
        whole=Whole("0" * 64, 0.0, seconds),
        samples=int(seconds * RATE),
        rate_hz=RATE,
        passed_over=False,
        squares=np.ones((blocks, 1)),
        counts=np.ones((blocks, 1)),
        travel=0.5 * BLOCK_S * np.stack([size, size], axis=1)[:, None],
        usable=np.ones(blocks) if usable is None else usable,
        places=(),
    )


@pytest.mark.parametrize(
    ("seconds", "held"), [(600.0, 140.0), (3600.0, 140.0), (200.0, 143.0)]
)
def test_pieces_fill_what_may_be_held_and_reach_over_the_time(
    seconds: float, held: float
) -> None:
    (pieces,) = excerpts_of([survey(seconds)], held * RATE)
    assert sum(b - a for a, b in pieces) == pytest.approx(held, rel=1e-9)
    assert len(pieces) == round(held / PIECE_S)
    assert all(b <= c for (_, b), (c, _) in pairwise(pieces))
    assert pieces[0][1] <= seconds / len(pieces) + 1e-9
    assert pieces[-1][0] >= seconds * (1 - 1 / len(pieces)) - 1e-9


def test_the_stretch_of_most_travel_is_taken() -> None:
    speed = np.full(int(900.0 / BLOCK_S) + 1, 0.2)
    speed[int(500.0 / BLOCK_S) : int(524.0 / BLOCK_S)] = 2.0
    (pieces,) = excerpts_of([survey(900.0, speed=speed)], 60.0 * RATE)
    assert any(a >= 498.0 and b <= 526.0 for a, b in pieces)


def test_every_log_has_its_part_and_a_gap_has_none() -> None:
    usable = np.ones(301)
    usable[50:150] = 0.0
    logs = [survey(600.0, usable=usable), survey(60.0), survey(60.0)]
    pieces = excerpts_of(logs, 120.0 * RATE)
    assert all(pieces)
    assert all(b <= 102.0 or a >= 298.0 for a, b in pieces[0])
    assert sum(b - a for some in pieces for a, b in some) <= 121.0
