"""Constant-velocity stretches are found in trapezoids, lie inside them, and nowhere else."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.logs.checks.echo import driven
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.segmentation import (
    SMALLEST_STEP,
    Stretch,
    constant_velocity,
    noise_step,
)
from seqid_cli.typing import Array
from tests.plants.motions.trajectories import Reference, hold, join, side_by_side, sweeps, trapezoid
from tests.plants.sensors import quantise

COARSE, MIDDLE, FINE = (2 * np.pi / counts for counts in (600, 2**12, 2**17))
SPEEDS = (0.1, 0.4, 1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Case:
    """A reference, what the encoders show of it, and what was found."""

    reference: Reference
    q: Array
    found: list[Stretch]

    def true_parts(self, joint: int) -> list[tuple[int, int]]:
        """Index ranges in which the joint really runs at constant velocity."""
        steady = (self.reference.ddq[:, joint] == 0) & (self.reference.dq[:, joint] != 0)
        return runs(steady, len(steady))


def find(reference: Reference, step: float, valid: NDArray[np.bool_] | None = None) -> Case:
    q = quantise(reference.q, step)
    mask = np.ones(len(q), dtype=bool) if valid is None else valid
    found = constant_velocity(q, reference.rate_hz, step=noise_step(q), valid=mask)
    return Case(reference, q, found)


@pytest.fixture(
    scope="module",
    params=[(rate, step) for rate in (100.0, 250.0, 1000.0) for step in (COARSE, MIDDLE, FINE)],
    ids=lambda p: f"{p[0]:.0f}Hz-{2 * np.pi / p[1]:.0f}counts",
)
def trapezoids(request: pytest.FixtureRequest) -> Case:
    """Joint 0 of two goes both ways at five speeds over forty to one, in one file."""
    rate, step = request.param
    return find(sweeps(np.zeros(2), 0, (-2.0, 2.0), SPEEDS, 20.0, rate_hz=rate), step)


def test_every_constant_part_of_every_trial_is_found_once(trapezoids: Case) -> None:
    parts = trapezoids.true_parts(0)
    assert len(parts) == len(trapezoids.found) == 2 * len(SPEEDS)
    for (start, stop), stretch in zip(parts, trapezoids.found, strict=True):
        assert stretch.joint == 0
        assert start <= stretch.start
        assert stretch.stop <= stop
        assert stretch.samples > 0.5 * (stop - start)


def test_a_reversal_without_rest_is_two_stretches() -> None:
    profile = [trapezoid(a, b, 1.5, 15.0, 250.0) for a, b in ((-1.5, 1.5), (1.5, -1.5))] * 2
    q, dq, ddq = (np.concatenate([p[i] for p in profile])[:, None] for i in range(3))
    for step in (COARSE, FINE):
        case = find(Reference(q, dq, ddq, 250.0), step)
        assert [np.sign(s.velocity) for s in case.found] == [1, -1, 1, -1]
        for (start, stop), stretch in zip(case.true_parts(0), case.found, strict=True):
            assert start <= stretch.start < stretch.stop <= stop


def test_moves_of_two_joints_at_once_are_not_trials() -> None:
    both = [trapezoid(-1.5, 1.5, 1.0, 10.0, 250.0), trapezoid(1.0, -1.0, 0.8, 10.0, 250.0)]
    reference = side_by_side([*both, (np.full(1, 0.3), np.zeros(1), np.zeros(1))], 250.0)
    rest = hold(reference.q[0], 0.5, 250.0)
    for step in (COARSE, FINE):
        case = find(join([rest, reference]), step)
        # Joint 0 arrives last; what it does alone is a trial of its own.
        shared = case.reference.dq[:, 1] != 0
        assert not any(shared[s.start : s.stop].any() for s in case.found)


@pytest.mark.parametrize("step", [COARSE, FINE])
@pytest.mark.parametrize("frequency", [0.05, 0.1, 0.3, 1.0, 3.0])
def test_what_is_taken_of_a_sine_is_constant_within_four_percent(
    frequency: float, step: float
) -> None:
    t = np.arange(0, 20, 1 / 500.0)
    angle = 2 * np.pi * frequency * t
    q = np.column_stack([1.5 * np.sin(angle), np.zeros_like(t)])
    dq = 1.5 * 2 * np.pi * frequency * np.cos(angle)
    q = quantise(q, step)
    found = constant_velocity(q, 500.0, step=noise_step(q), valid=np.ones(len(t), dtype=bool))
    for stretch in found:
        own = dq[stretch.start : stretch.stop]
        assert np.ptp(own) < 0.04 * np.abs(own).max()
    if frequency >= 1.0:
        assert not found


def test_a_stretch_ends_at_a_gap() -> None:
    reference = sweeps(np.zeros(1), 0, (-2.0, 2.0), [0.5], 10.0, rate_hz=250.0)
    valid = np.ones(len(reference.q), dtype=bool)
    start, stop = runs(reference.dq[:, 0] > 0, len(valid))[0]
    middle = (start + stop) // 2
    valid[middle : middle + 60] = False
    case = find(reference, FINE, valid)
    ahead = [s for s in case.found if s.velocity > 0]
    assert len(ahead) == 2
    assert all(valid[s.start : s.stop].all() for s in case.found)
    assert ahead[0].stop <= middle < middle + 60 <= ahead[1].start


@pytest.mark.parametrize("step", [1e-6, 1e-5, 1e-4])
def test_a_linear_axis_in_metres(step: float) -> None:
    reference = sweeps(np.zeros(2), 1, (0.0, 0.4), [0.02, 0.1, 0.3], 2.0, rate_hz=500.0)
    case = find(reference, step)
    parts = case.true_parts(1)
    assert len(case.found) == len(parts) == 6
    for (start, stop), stretch in zip(parts, case.found, strict=True):
        assert start <= stretch.start < stretch.stop <= stop
        assert stretch.velocity == pytest.approx(reference.dq[start + 1, 1], rel=2e-3)


def test_a_noisy_position_without_steps() -> None:
    reference = sweeps(np.zeros(2), 0, (-1.5, 1.5), [0.2, 1.0], 10.0, rate_hz=500.0)
    noise = 2e-4 * np.random.default_rng(0).standard_normal(reference.q.shape)
    q = reference.q + noise
    found = constant_velocity(q, 500.0, step=noise_step(q), valid=np.ones(len(q), dtype=bool))
    parts = Case(reference, q, found).true_parts(0)
    assert len(found) == len(parts) == 4
    for (start, stop), stretch in zip(parts, found, strict=True):
        assert start <= stretch.start < stretch.stop <= stop
        assert stretch.velocity == pytest.approx(reference.dq[start + 1, 0], rel=2e-3)


def test_noise_step_sees_counts_and_noise() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(4000) / 250.0
    smooth = np.sin(t)
    counts = quantise(smooth, MIDDLE)
    noisy = smooth + 1e-3 * rng.standard_normal(len(t))
    step = noise_step(np.column_stack([counts, noisy, smooth]))
    assert step[0] == pytest.approx(MIDDLE, rel=0.01)
    assert step[1] == pytest.approx(3e-3, rel=0.15)
    assert step[2] == SMALLEST_STEP
    assert noise_step(counts[:, None], np.array([2 * MIDDLE]))[0] == pytest.approx(2 * MIDDLE)


def test_a_joint_that_others_shake_is_held() -> None:
    t = np.linspace(0.0, 10.0, 2001)
    shaken = 0.2 * np.exp(-(((t - 5.0) / 0.05) ** 2))
    q = np.column_stack([np.sin(t), 0.3 * np.cos(t), shaken, np.zeros_like(t)])
    q[7] = np.nan
    assert driven(q).tolist() == [True, True, False, False]
