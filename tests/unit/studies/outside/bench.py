"""Arms and logs that the tests of this simulator share."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests import Array
from tests.studies.outside.arms import Arm, Drive, Link, drawn_arm

Mask = NDArray[np.bool_]


def pendulum(coulomb: float = 0.0) -> Arm:
    """One link that points up at zero, about a horizontal axis; nothing is noisy."""
    inertia = np.diag([0.02, 0.02, 0.01])
    origin, axis, centre = (
        np.zeros(3),
        np.array([0.0, 1.0, 0.0]),
        np.array([0.0, 0.0, 0.4]),
    )
    link = Link(origin, origin, axis, 2.0, centre, inertia)
    drive = Drive(0.1, coulomb, 0.1, 0.0, 0.0, 50.0, 0.1, 1e-6, rise=10.0, warm_s=100.0)
    return Arm("drawn", (link,), (drive,), 500.0, 0.0, 60.0, 1.0, True, False)


def quiet_arm(seed: int) -> Arm:
    """A drawn arm of two joints without noise in its torques."""
    arm = drawn_arm(np.random.default_rng(seed), "drawn", 2, imus=False)
    return replace(arm, noise=0.0, rate_hz=500.0)


def sweeps(
    t: Array, q: Array, speed: float, at: float, width: float = 0.05
) -> tuple[Mask, Mask]:
    """Rows on the way up and on the way down at a speed and near a place, accelerating
    nowhere.
    """
    v = np.gradient(q, t)
    near: Mask = (np.abs(q - at) < width) & (np.abs(np.abs(v) - speed) < 0.1 * speed)
    return near & (v > 0), near & (v < 0)
