"""The low-pass at the kept samples only against that at all of them."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.motion.filtering import Lowpass, differentiate
from seqid_cli.motion.kept_filter import LEAST, can_keep, kept_filter

RATE_HZ = 1000.0
SAMPLES = 40_000
MARGIN = 12_000
FIRST = MARGIN + 7


@pytest.mark.parametrize(("cutoff_hz", "every"), [(3.65, 27), (5.0, 20), (10.0, 10), (11.0, LEAST)])
def test_as_filtered_at_all_samples(cutoff_hz: float, every: int) -> None:
    rng = np.random.default_rng(every)
    x = 3.0 + np.cumsum(rng.normal(size=SAMPLES)) / 100
    lowpass = Lowpass(cutoff_hz, RATE_HZ)
    once = lowpass(x[:, None])
    twice = lowpass(once)
    kept = FIRST + every * np.arange((SAMPLES - MARGIN - FIRST) // every)
    found = kept_filter(cutoff_hz, RATE_HZ, every, derivatives=True)(x, FIRST, len(kept))
    for order, wanted in enumerate((once, *differentiate(once, RATE_HZ))):
        worst = np.abs(found[order] - wanted[kept, 0]).max()
        assert worst < 5e-12 * np.abs(x).max() * RATE_HZ**order
    torque = kept_filter(cutoff_hz, RATE_HZ, every, passes=2)(x, FIRST, len(kept))
    assert np.abs(torque[0] - twice[kept, 0]).max() < 5e-12 * np.abs(x).max()


def test_not_where_derivatives_reach_into_other_blocks_or_digits_are_lost() -> None:
    assert can_keep(5.0, RATE_HZ, LEAST)
    assert not can_keep(5.0, RATE_HZ, LEAST - 1)
    assert not can_keep(0.5, RATE_HZ, 100)
