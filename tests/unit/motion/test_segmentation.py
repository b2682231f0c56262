"""Constant-velocity stretches are found in trapezoids, lie inside them, and nowhere
else.
"""

import numpy as np
import pytest

from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.segmentation import (
    SMALLEST_STEP,
    Stretch,
    constant_velocity,
    noise_step,
)
from seqid_cli.typing import Array, Mask
from tests.plants.motions.trajectories import (
    Reference,
    hold,
    join,
    side_by_side,
    sweeps,
    trapezoid,
)
from tests.plants.sensors import quantise

COARSE, MIDDLE, FINE = (2 * np.pi / counts for counts in (600, 2**12, 2**17))


def find(reference: Reference, q: Array, valid: Mask | None = None) -> list[Stretch]:
    mask = np.ones(len(q), dtype=bool) if valid is None else valid
    return constant_velocity(q, reference.rate_hz, step=noise_step(q), valid=mask)


def assert_found_once(
    reference: Reference, q: Array, count: int, least: float = 0.0
) -> list[Stretch]:
    """Each stretch lies within a constant part of joint 0, holds a share of it, knows
    its speed.
    """
    stretches = find(reference, q)
    parts = runs((reference.ddq[:, 0] == 0) & (reference.dq[:, 0] != 0), len(q))
    assert len(parts) == len(stretches) == count
    for (start, stop), stretch in zip(parts, stretches, strict=True):
        assert start <= stretch.start < stretch.stop <= stop
        assert stretch.samples > least * (stop - start)
        true = reference.dq[start + 1, stretch.joint]
        assert stretch.velocity == pytest.approx(true, rel=2e-3, abs=1e-3)
    return stretches


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
@pytest.mark.parametrize("step", [COARSE, MIDDLE, FINE, 0.0])
def test_every_constant_part_of_every_trial_is_found_once(
    rate: float, step: float
) -> None:
    """Joint 0 of two goes both ways at five speeds over forty to one; then without
    steps.
    """
    speeds = (0.1, 0.4, 1.0, 2.0, 4.0) if step else (0.2, 1.0, 2.0, 3.0, 4.0)
    reference = sweeps(np.zeros(2), 0, (-2.0, 2.0), speeds, 20.0, rate_hz=rate)
    noise = 2e-4 * np.random.default_rng(0).standard_normal(reference.q.shape)
    q = quantise(reference.q, step) if step else reference.q + noise
    assert_found_once(reference, q, 10, 0.5)


@pytest.mark.parametrize("step", [COARSE, FINE])
def test_a_reversal_without_rest_is_two_stretches(step: float) -> None:
    profile = [
        trapezoid(a, b, 1.5, 15.0, 250.0) for a, b in ((-1.5, 1.5), (1.5, -1.5))
    ] * 2
    q, dq, ddq = (
        np.concatenate(parts)[:, None] for parts in zip(*profile, strict=True)
    )
    stretches = assert_found_once(Reference(q, dq, ddq, 250.0), quantise(q, step), 4)
    assert [np.sign(s.velocity) for s in stretches] == [1, -1, 1, -1]


@pytest.mark.parametrize("step", [COARSE, FINE])
def test_moves_of_two_joints_at_once_are_not_trials(step: float) -> None:
    profiles = [
        trapezoid(-1.5, 1.5, 1.0, 10.0, 250.0),
        trapezoid(1.0, -1.0, 0.8, 10.0, 250.0),
    ]
    moves = side_by_side(
        [*profiles, (np.full(1, 0.3), np.zeros(1), np.zeros(1))], 250.0
    )
    reference = join([hold(moves.q[0], 0.5, 250.0), moves])
    # Joint 0 arrives last; what it does alone is a trial of its own.
    shared = reference.dq[:, 1] != 0
    stretches = find(reference, quantise(reference.q, step))
    assert not any(shared[s.start : s.stop].any() for s in stretches)


@pytest.mark.parametrize("step", [COARSE, FINE])
@pytest.mark.parametrize("frequency", [0.05, 0.1, 0.3, 1.0, 3.0])
def test_what_is_taken_of_a_sine_is_nearly_constant(
    frequency: float, step: float
) -> None:
    w = 2 * np.pi * frequency
    angle = w * np.arange(0, 20, 1 / 500.0)[:, None]
    two = np.array([1.5, 0.0])
    q = two * np.sin(angle)
    dq = two * w * np.cos(angle)
    ddq = -two * w**2 * np.sin(angle)
    stretches = find(Reference(q, dq, ddq, 500.0), quantise(q, step))
    for stretch in stretches:
        velocity = dq[stretch.start : stretch.stop, 0]
        assert np.ptp(velocity) < 0.04 * np.abs(velocity).max()
    assert frequency < 1.0 or not stretches


def test_a_stretch_ends_at_a_gap() -> None:
    reference = sweeps(np.zeros(1), 0, (-2.0, 2.0), [0.5], 10.0, rate_hz=250.0)
    start, stop = runs(reference.dq[:, 0] > 0, len(reference.q))[0]
    middle = (start + stop) // 2
    valid = np.ones(len(reference.q), dtype=bool)
    valid[middle : middle + 60] = False
    stretches = find(reference, quantise(reference.q, FINE), valid)
    first, second = (s for s in stretches if s.velocity > 0)
    assert all(valid[s.start : s.stop].all() for s in stretches)
    assert first.stop <= middle < middle + 60 <= second.start


def test_noise_step_sees_counts_and_noise() -> None:
    smooth = np.sin(np.arange(4000) / 250.0)
    counts = quantise(smooth, MIDDLE)
    noisy = smooth + 1e-3 * np.random.default_rng(1).standard_normal(4000)
    step = noise_step(np.column_stack([counts, noisy, smooth]))
    assert step[0] == pytest.approx(MIDDLE, rel=0.01)
    assert step[1] == pytest.approx(3e-3, rel=0.15)
    assert step[2] == SMALLEST_STEP
    assert noise_step(counts[:, None], np.array([2 * MIDDLE]))[0] == pytest.approx(
        2 * MIDDLE
    )
