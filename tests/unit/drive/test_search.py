"""Delays where commands step: all times between two rows are alike."""

from dataclasses import dataclass

import numpy as np
import pytest

from seqid_cli.drive import search
from seqid_cli.drive.equations import Delays
from seqid_cli.drive.search import Solution

LAG_S = 0.004
TRUE_S = 0.0412  # from a command to the torque


@dataclass(frozen=True)
class Valley:
    """A law of which the least is broad, and beyond the times that are scanned."""

    used: tuple[()] = ()
    logs: tuple[()] = ()


def at(law: Valley, names: list[str], total_s: float, lag_s: float) -> Solution:
    away = (total_s - TRUE_S) / 1e-3
    return Solution(
        delays=Delays(command=total_s - LAG_S, torque=LAG_S),
        theta=np.ones(1),
        squares=1.0 + 0.2 * away**2,
    )


def test_the_least_is_found_beyond_the_times_that_were_scanned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scanned = np.arange(0.0390, 0.0402, 1e-4)
    monkeypatch.setattr(search, "_scanned", lambda law, names, start: scanned)
    monkeypatch.setattr(search, "_with_lag", at)
    monkeypatch.setattr(search, "independent_rows", lambda law: 1000.0)
    monkeypatch.setattr(search, "solved_at", lambda law, names, delays: None)
    found = search._refined_held(
        Valley(), ["proportional"], Delays(command=0.035, torque=LAG_S)
    )
    assert found.delays.command + found.delays.torque == pytest.approx(TRUE_S, abs=5e-4)
