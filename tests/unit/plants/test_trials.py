"""The logs of a study: what repeats, what is held out, and what the cache returns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.plants.cases import RIGS, Case, injections, motions
from tests.plants.simulate import Log, Truth
from tests.plants.trials import FADE, RATE_HZ, record


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


def test_same_case_same_logs_from_the_run_and_from_the_cache(tmp_path: Path) -> None:
    """Run, stored and read again; another effect is another file."""
    case = Case("vertical_two_joint", 3, (("thermal_friction", 1, 1.0),), seconds=3.0)
    plant, chosen = injections(case)[-1].plant, motions(case)[1:6:3]
    first = record(plant, chosen, 3, cache=tmp_path, label=repr(case))
    stored = sorted(tmp_path.iterdir())
    assert len(stored) == 2
    again = record(plant, chosen, 3, cache=tmp_path, label=repr(case))
    assert sorted(tmp_path.iterdir()) == stored
    fresh = record(plant, chosen, 3)
    for one, two, three in zip(first, again, fresh, strict=True):
        same(one.log, two.log)
        same(one.log, three.log)
        assert one.log.start == one.drill.start
    record(plant, chosen[:1], 3, cache=tmp_path, label="another")
    assert len(list(tmp_path.iterdir())) == 3


def same(one: Log, two: Log) -> None:
    """Equal to the last bit."""
    for name in ("t", "q", "current", "temperature"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    for name in Truth.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one.truth, name), getattr(two.truth, name))
    assert one.start == two.start
