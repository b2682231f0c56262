"""What only looks like a fault of a channel: fast moves, zeros, coarse currents."""

import numpy as np
import pytest

from seqid_cli.inspect.channels.positions import breaks_of
from seqid_cli.inspect.channels.torques import _stuck
from tests import Array
from tests.unit.inspect.faults import SIX, SIX_ROBOT


def fast_moves(rate_hz: float) -> Array:
    """Moves to and fro within one sample, as fast as the arm is allowed, and rests."""
    row = np.arange(round(20.0 * rate_hz))
    place = row // round(3.0 * rate_hz) % 2
    return 2.6 / rate_hz * place + 0.02 * np.sin(row / rate_hz)


@pytest.mark.parametrize("rate_hz", [15.0, 30.0, 50.0])
def test_a_fast_move_at_a_low_rate_is_no_jump(rate_hz: float) -> None:
    q = fast_moves(rate_hz)
    t = np.arange(len(q)) / rate_hz
    assert breaks_of(SIX_ROBOT, t, np.tile(q[:, None], (1, len(SIX)))) == []


@pytest.mark.parametrize("rate_hz", [30.0, 250.0])
def test_a_zero_set_anew_is_still_a_jump(rate_hz: float) -> None:
    t = np.arange(round(20.0 * rate_hz)) / rate_hz
    q = 0.3 * np.sin(t) + 0.4 * (t > 10.0)
    found = breaks_of(SIX_ROBOT, t, np.tile(q[:, None], (1, len(SIX))))
    assert {damage.finding.code for damage in found} == {"position_jump"}


def current(kind: str) -> tuple[Array, Array, Array]:
    """A current that stays at a value for 0.8 s while its joint moves."""
    t = np.arange(4000) / 250.0
    rng = np.random.default_rng(6)
    values = 2.0 * np.sin(1.3 * t) + 0.05 * rng.standard_normal(len(t))
    inside = (t > 6.0) & (t < 6.8)
    if kind == "let go":
        values[inside] = 0.0
    elif kind == "coarse":
        values = 0.8 * np.round((values + 0.5 * rng.standard_normal(len(t))) / 0.8)
        values[inside] = 0.8
    else:
        values[inside] = values[inside][0]
    return values, t, np.ones(len(t), np.bool_)


@pytest.mark.parametrize("kind", ["let go", "coarse", "stuck"])
def test_zeros_and_levels_of_a_coarse_current_are_not_stuck(kind: str) -> None:
    assert bool(_stuck(*current(kind))) == (kind == "stuck")
