"""Friction of thinned motion against that of the full motion, both low-passed."""

from dataclasses import replace

import numpy as np

from seqid_cli.model.friction import FrictionSurface, friction_torque
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion, decimated
from tests import Array
from tests.plants.robots.made import made_motion

RATE_HZ, CUTOFF_HZ, SAMPLES = 1000.0, 5.0, 30_000


def surface() -> FrictionSurface:
    """Coulomb and viscous friction with a step that the full rate resolves."""
    entries = np.array([[2.0, 0.5]])
    covariance = np.eye(2)
    return FrictionSurface(
        Scaling((-3.0, 3.0), (0.0, 6.0)), 0.05, entries, entries, covariance, directional=False
    )


def motion() -> Motion:
    """Two joints that reverse again and again, at any time between two samples."""
    t = np.arange(SAMPLES)[:, None] / RATE_HZ
    w, phase = np.array([2.9, 4.1]), np.array([0.3, 1.1])
    slow = 1 + 0.2 * np.sin(0.37 * t)
    q, dq = slow * np.sin(w * t + phase), slow * w * np.cos(w * t + phase)
    ddq = -slow * w**2 * np.sin(w * t + phase)
    return made_motion(q, dq, ddq, Lowpass(CUTOFF_HZ, RATE_HZ))


def test_thinned_friction_is_the_full_one_after_the_low_pass() -> None:
    full = motion()
    thinned = decimated(full)
    assert thinned.lowpass.every == 20
    surfaces: list[FrictionSurface | None] = [surface(), None]
    expected = full.filtered(friction_torque(surfaces, full.q, full.dq), times=2)[::20]
    inner = slice(100, -100)

    def error(torque: Array) -> float:
        return float(np.abs(thinned.filtered(torque, times=2) - expected)[inner].max())

    assert error(sampled_friction(surfaces, thinned)) < 2e-3
    # Samples of the step alone are known to half a sample.
    assert error(friction_torque(surfaces, thinned.q, thinned.dq)) > 0.05
    assert not sampled_friction(surfaces, thinned)[:, 1].any()


def test_beside_gaps_it_is_the_surface_itself() -> None:
    thinned = decimated(motion())
    valid = thinned.valid.copy()
    valid[700:720] = False
    broken = thinned.q.copy()
    broken[700:720] = 1e6
    surfaces: list[FrictionSurface | None] = [surface(), surface()]
    gap = replace(thinned, valid=valid, q=broken)
    whole, found = (sampled_friction(surfaces, m) for m in (thinned, gap))
    rows = np.r_[0:690, 730 : len(valid)]
    np.testing.assert_allclose(found[rows], whole[rows], rtol=1e-14)
    near = np.r_[693:700, 720:727]
    plain = friction_torque(surfaces, thinned.q, thinned.dq)
    np.testing.assert_array_equal(found[near], plain[near])
