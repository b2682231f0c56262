"""Where a joint stops or turns back though its low-passed motion goes on."""

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.effects.scenes import CUTOFF_HZ, RATE_HZ, scene_of

SPEED = 0.3
HUNTS_HZ = 3.0 * CUTOFF_HZ


@pytest.mark.parametrize(
    ("swing", "stops"), [(0.0, False), (0.5, False), (1.1, True), (1.5, True)]
)
def test_a_joint_that_stops_above_the_cut_off(swing: float, stops: bool) -> None:
    """It hunts by `swing` of its speed between 4 and 6 s; the low-passed motion hardly
    shows it.
    """
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    rate = 2.0 * np.pi * HUNTS_HZ
    hunts = np.where(
        (t > 4.0) & (t < 6.0), swing * SPEED * np.sin(rate * t) / rate, 0.0
    )
    q = np.column_stack([SPEED * t + hunts, np.sin(t)])
    hunting = replace(scene_of(q), encoder=q)
    inside = (t > 4.5) & (t < 5.5)
    earlier = (t > 2.0) & (t < 3.5)
    assert np.min(hunting.motion.dq[inside, 0]) > 0.1 * SPEED
    assert np.all(hunting.stops[inside, 0] == stops)
    assert not np.any(hunting.stops[earlier, 0])
    assert np.all(hunting.slides[inside | earlier, 0])
