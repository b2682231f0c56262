"""What acceleration is left in trials of constant velocity is known from their ramps."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import without_acceleration
from seqid_cli.identify.friction_surface.trials import Ramps, Trial, collect_trials
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.motions.trajectories import sweeps
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r
from tests.plants.sensors import quantise

RATE = 500.0
INERTIA, COULOMB, VISCOUS = 0.8, 2.0, 0.5


def surface(*, off: float = 0.0) -> FrictionSurface:
    """Coulomb and viscous friction between 0.2 and 2 rad/s; Coulomb's is `off`."""
    linear = np.array([[COULOMB + off + VISCOUS * 1.1, VISCOUS * 0.9]])
    return FrictionSurface(
        Scaling((-1.6, 1.6), (0.2, 2.0)), 0.01, linear, linear, np.zeros((2, 2)), directional=False
    )


def trials_of(robot: Robot, *, wobble: float = 0.0, seed: int = 0) -> list[Trial]:
    """Sweeps of the second joint, the speed wavering over the position, torque with white noise."""
    rng = np.random.default_rng(seed)
    path = sweeps(np.array([0.4, 0.0]), 1, (-1.5, 1.5), [0.3, 0.8, 1.8], 6.0, rate_hz=RATE).q
    path[:, 1] += wobble * np.sin(3.0 * path[:, 1])
    fine = path[:, 1]
    v, a = np.gradient(fine) * RATE, np.gradient(np.gradient(fine)) * RATE**2
    tau = np.zeros_like(path)
    tau[:, 1] = INERTIA * a + (COULOMB + VISCOUS * np.abs(v)) * np.sign(v)
    tau[:, 1] += 0.05 * rng.standard_normal(len(fine))
    log = made_recording(quantise(path, 1e-4), tau, rate_hz=RATE, path="sweeps.parquet")
    return collect_trials([log], robot)


def friction_left(trials: list[Trial]) -> Array:
    """What a trial at its mean velocity should not have beyond friction, away from its ends."""
    return np.concatenate(
        [(t.tau - surface().torque(t.q, np.full(len(t.q), t.velocity)))[6:-6] for t in trials]
    )


def test_ramps_tell_the_inertia_within_its_error() -> None:
    robot = planar_2r()
    off = []
    for seed in range(12):
        (group,) = without_acceleration(robot, trials_of(robot, wobble=0.01, seed=seed), surface())
        off.append((group.inertia - INERTIA) / group.std_error)
        assert group.std_error < 0.02 * INERTIA
    assert np.sqrt(np.mean(np.square(off))) < 1.8


def test_the_torque_of_a_wavering_speed_is_taken_off() -> None:
    robot = planar_2r()
    given = trials_of(robot, wobble=0.01)
    (group,) = without_acceleration(robot, given, surface())
    before, after = friction_left(given), friction_left(group.trials)
    assert np.std(after) < 0.35 * np.std(before)


def test_where_no_ramp_tells_anything_all_torque_may_be_that_of_acceleration() -> None:
    robot = planar_2r()
    given = trials_of(robot, wobble=0.01)
    blind = [replace(trial, ramps=Ramps()) for trial in given]
    (told,), (unknown,) = (without_acceleration(robot, t, surface()) for t in (given, blind))
    assert all(trial.inertia_error == told.std_error for trial in told.trials)
    assert unknown.inertia == 0.0
    for trial in unknown.trials:
        assert trial.inertia_error >= INERTIA
        pushed = max(trial.inertia_error * np.sqrt(np.mean(t.ddq**2)) for t in unknown.trials)
        assert pushed > 0.5 * np.median(np.abs(trial.tau))


def test_slices_in_which_a_controller_still_settles_are_left_out() -> None:
    robot = planar_2r()
    (given, *_) = [t for t in trials_of(robot) if t.velocity > 1.0]
    pushed = np.where(np.arange(len(given.q)) < 3, 4.0, 0.0)  # rad/s^2 by a path that overshoots
    trial = replace(given, ddq=pushed, tau=given.tau + 0.2 * INERTIA * pushed)
    (group,) = without_acceleration(robot, [trial, *trials_of(robot)], surface())
    kept = group.trials[0]
    assert kept.t == pytest.approx(trial.t[3:])
    assert len(kept.q) == len(kept.dq) == len(kept.ddq) == len(kept.tau) == len(kept.t)
    assert abs(friction_left([kept]).mean()) < 0.05
