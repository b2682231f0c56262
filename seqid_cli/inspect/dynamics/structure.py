"""What the robot's equations leave of a torque, whatever the inertial parameters are.

All joints share one set of base parameters (gravity and inertia); each has friction of
its own.
"""

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample, scaled_residual
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.typing import Array, Mask


def sliding(sample: Sample, *, min_speed: float = 0.2) -> Mask:
    """Return where (N, n) moving joints slide: at rest friction takes any value."""
    is_fast = np.abs(sample.dq) > min_speed * sample.rms_speeds
    return np.asarray(is_fast & np.isin(np.arange(sample.robot.n), sample.moving))


def torque_sizes(sample: Sample) -> Array:
    """Return the RMS (n,) of each torque where its joint slides, never quite zero."""
    slides = sliding(sample)
    squares = np.where(slides, sample.tau, 0.0) ** 2
    count = np.maximum(slides.sum(axis=0), 1)
    return np.asarray(np.sqrt(squares.sum(axis=0) / count).clip(1e-12))


def structural_residual(sample: Sample) -> Array:
    """Return what rigid body and friction leave (R,), in shares of each torque's RMS.

    R counts the rows of all joints in which they slide.
    """
    assert sample.basis is not None
    n = sample.robot.n
    Y = base_regressor(sample.robot, sample.basis, sample.q, sample.dq, sample.ddq)
    # Joints share the rigid body, but no joint has the friction of another.
    friction = sample.friction_columns()[:, :, None] * np.eye(n)[:, :, None]
    X = np.concatenate([Y, friction.reshape(len(sample.tau), n, -1)], axis=2)

    slides = sliding(sample)
    size = torque_sizes(sample) if sample.sizes is None else sample.sizes
    return scaled_residual((X / size[:, None])[slides], (sample.tau / size)[slides])


def structural_error(sample: Sample) -> float:
    """Return the RMS that rigid body and friction leave, in shares of each torque."""
    return float(np.sqrt(np.mean(structural_residual(sample) ** 2)))
