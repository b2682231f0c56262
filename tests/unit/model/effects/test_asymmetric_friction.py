"""Differences between the directions, from two one-sided laws."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.asymmetric_friction import AsymmetricFriction
from tests.unit.model.effects.fitting import Array, direction, fit, trial

FORTH, BACK = (3.0, 1.1), (2.2, 0.8)  # Coulomb N m, viscous N m s/rad


def law(t: Array, q: Array, dq: Array) -> Array:
    """One law forth, another back, nothing at rest."""
    dry, wet = np.where(dq > 0, FORTH[0], BACK[0]), np.where(dq > 0, FORTH[1], BACK[1])
    return dry * direction(dq) + wet * dq


@pytest.mark.parametrize("offset", [False, True])
def test_half_differences_come_back(offset: bool) -> None:
    """Also beside a free offset, by the rests and reversals."""
    trials = [trial(law, seed=k, noise=0.1) for k in range(3)]
    found = fit(AsymmetricFriction(), trials, joint=0, offset=offset)
    wanted = [0.5 * (a - b) for a, b in zip(FORTH, BACK, strict=True)]
    assert found.c == pytest.approx(wanted, rel=0.1)
    assert found.left < 0.05
