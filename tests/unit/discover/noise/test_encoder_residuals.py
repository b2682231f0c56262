from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.encoder import encoder_residuals
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.scenes import scenes_of, with_own_cutoffs
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from tests.plants.arms.rigs import plain, two_joint
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.motions.experiments import span_of
from tests.plants.motions.trajectories import fourier
from tests.plants.robots.sample import sample_robot
from tests.plants.simulate import simulate
from tests.unit.discover.drawn_logs import recording

JOINTS, SECONDS, EVERY = 2, 30.0, 2


@pytest.fixture(scope="module")
def log() -> Recording:
    """A log of the two-joint rig with Coulomb and viscous friction, 500 Hz."""
    plant = two_joint()
    assert isinstance(plant.friction, SurfaceFriction)
    plant = replace(plant, friction=plain(plant.friction))
    low, high = np.array([span_of(plant, j) for j in range(JOINTS)]).T
    limits = (0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits)
    rng = np.random.default_rng(5)
    motion = fourier(rng, low, high, *limits, seconds=SECONDS, harmonics=24, rate_hz=1000.0)
    found = simulate(plant, motion, 0, every=EVERY, imus=False)
    return recording(found.q, found.current * plant.torque_per_ampere, 1000.0 / EVERY)


@pytest.mark.slow
def test_the_encoders_part_is_smaller_than_what_is_left(log: Recording) -> None:
    robot = sample_robot("two_joint")
    friction, inertia = identify_simultaneous([log], robot, options=MotionOptions())
    stages = Stages(friction=friction, inertia=inertia)
    (scene,) = scenes_of([log], robot, stages, options=InertiaOptions())
    (echo,) = encoder_residuals([log], [scene])
    left, slides = residual_of(scene), scene.slides
    for j in range(JOINTS):
        assert 0.01 * rms(left[slides[:, j], j]) < rms(echo[slides[:, j], j])
        assert rms(echo[slides[:, j], j]) < rms(left[slides[:, j], j])


@pytest.mark.slow
def test_a_log_whose_encoders_are_too_coarse_is_filtered_at_its_own_cutoff(log: Recording) -> None:
    robot = sample_robot("two_joint")
    friction, inertia = identify_simultaneous([log], robot, options=MotionOptions())
    stages = Stages(friction=friction, inertia=inertia)
    own = estimate_motion(log, robot, MotionOptions()).cutoff.hz
    assert log.tau is not None
    larger = replace(log, tau=log.tau + 20.0 * np.std(log.tau, axis=0) * np.sin(3.0 * log.q))
    for given, origin, expected in (
        (log, "of the inertia stage", own),
        (log, "as given", 4.0 * own),
        (larger, "of the inertia stage", 4.0 * own),  # noise is no part of what is left there
    ):
        options = InertiaOptions(MotionOptions(4.0 * own, origin=origin), source="needed")
        options = with_own_cutoffs([given], robot, stages, options)
        (scene,) = scenes_of([given], robot, stages, options=options)
        assert scene.motion.cutoff.hz == pytest.approx(expected)
