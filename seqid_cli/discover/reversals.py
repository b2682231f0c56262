"""What a reversal leaves of friction, whatever the joint is made of.

A joint that reverses sticks or creeps for a moment, and its low-passed velocity crosses zero at
another time than its own. Friction's step is then neither as sharp nor quite where the model has
it, and the low-pass spreads the difference over some tenths of a second:

    d2/dt2 of friction          a step that is a ramp T long: T^2 / 24 of it, to first order
    friction's slope times jerk the crossing shifts by c v'' / v', c the low-pass's second moment

Both are nuisances, as the time offset is: left out, clean logs of joints with much friction show
elasticity or presliding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filtering import differentiate

Array = NDArray[np.float64]


def reversal_columns(scene: Scene) -> Array:
    """Compute the columns (N, n, 2), low-passed, N m/s^2: a coefficient is a time squared."""
    motion = scene.motion
    friction = motion.filtered(scene.friction, times=2)
    blunt = differentiate(friction, motion.rate_hz, motion.valid)[1]
    shifted = motion.filtered(scene.friction_slope() * _jerk(scene), times=2)
    return np.stack([blunt, shifted], axis=2)


def _jerk(scene: Scene) -> Array:
    motion = scene.motion
    return differentiate(motion.ddq, motion.rate_hz, motion.valid)[0]
