"""Information of recorded logs on the base parameters."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.regression.equations import filtered_regressor, torque_motion
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.plan.belief import Belief

Array = NDArray[np.float64]


def information_of(belief: Belief, recordings: Iterable[Recording]) -> Array:
    """Sum up H' D H (b, b) over the samples of logs in which joints slide.

    Raises
    ------
    InputError
        A log carries neither torque nor current.
    """
    total = np.zeros((belief.basis.size, belief.basis.size))
    for recording in recordings:
        motion = torque_motion(recording, belief.robot, MotionOptions())
        for rows in filtered_regressor(motion, belief.robot, belief.basis):
            speed = rows.motion.dq**2
            slide = speed / (speed + belief.slow**2)
            weight = np.sqrt(belief.density * slide / motion.rate_hz)
            flat = (weight[..., None] * rows.H).reshape(-1, belief.basis.size)
            total += flat.T @ flat
    return total
