"""Checks of torques on their own numbers: what is not known is no fault."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.inspect.channels.torques import _spikes
from seqid_cli.inspect.dynamics.friction import Friction, _exchanged


@pytest.mark.parametrize(
    ("own", "pairs"), [((0.02, 0.05), [(0, 1)]), ((2.1, 1.6), []), ((0.0, 0.3), [])]
)
def test_torques_are_exchanged_only_where_friction_of_their_own_is_known_to_lack(
    own: tuple[float, float], pairs: list[tuple[int, int]]
) -> None:
    # Joint 0 moves and drags joint 1, which stands within its stiction, by 0.2 N m.
    fits = {0: Friction({0: own}, 3.0, 0.05), 1: Friction({0: (0.2, 0.01)}, 0.4, 0.1)}
    assert _exchanged(fits, (0,)) == pairs


@pytest.mark.parametrize(("length", "found"), [(1, 1), (2, 2), (3, 0)])
def test_what_lasts_three_samples_is_no_spike(length: int, found: int) -> None:
    values = np.sin(np.arange(1000) / 100.0)
    values[400 : 400 + length] += 5.0
    assert len(_spikes(values)) == found
