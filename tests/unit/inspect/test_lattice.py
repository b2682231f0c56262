"""The step of a quantised channel."""

import numpy as np
import pytest

from seqid_cli.inspect.channels.values import _refined, lattice


def test_the_step_is_found_to_all_digits() -> None:
    counts = np.random.default_rng(0).integers(-500, 500, 2000)
    assert lattice(counts * 0.0123) == pytest.approx(0.0123, rel=1e-9)


def test_levels_within_half_a_step_leave_it_as_it_is() -> None:
    with np.errstate(all="raise"):
        assert _refined(np.array([0.0, 0.1, 0.2, 50.0, 90.0]), 1.0) == pytest.approx(1.0, rel=0.01)
