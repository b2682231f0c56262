"""The logs of a study: what repeats, and what is held out."""

from __future__ import annotations

import numpy as np
import pytest

from tests.plants.cases import RIGS, Case, motions
from tests.plants.motions.trials import FADE, RATE_HZ


@pytest.mark.parametrize("rig", sorted(RIGS))
def test_motions_are_periodic_where_they_say_so(rig: str) -> None:
    """At least three periods that repeat to the last bit, inside the limits, rest to rest."""
    plant = RIGS[rig]()
    drills = motions(Case(rig, 4))
    assert [x.held_out for x in drills].count(True) == 2
    for drill in drills:
        motion = drill.reference
        assert 17.0 < motion.duration < 27.0
        assert (np.abs(motion.dq) <= 1.001 * plant.velocity_limits).all()
        assert (motion.q >= plant.position_limits[:, 0]).all()
        assert (motion.q <= plant.position_limits[:, 1]).all()
        step = np.abs(np.diff(motion.q, axis=0)).max(axis=0) * motion.rate_hz
        assert (step <= 1.001 * plant.velocity_limits).all(), drill.name
        assert np.abs(motion.dq[[0, -1]]).max() < 1e-3
        if drill.period is not None:
            count, edge = round(drill.period * RATE_HZ), round(FADE * RATE_HZ)
            whole = (len(motion.q) - 2 * edge) // count
            assert whole >= 3
            cycles = motion.q[edge : edge + whole * count].reshape(whole, count, -1)
            np.testing.assert_array_equal(cycles, np.broadcast_to(cycles[0], cycles.shape))
