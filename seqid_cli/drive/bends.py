"""What rows miss of speeds where commands step between them.

A step of a command is one of the acceleration, and a bend of the speed. The speed
itself has it in full. The slope of positions has not, which are sampled before they are
differentiated: what is above half of the rows' rate has come down into their band. With
the command c, free of its mean, and its integrals

    C1(t) = int c,    C2(t) = int C1,

positions hold a factor times C2, and speeds the same factor times C1. A low-pass F of
rows and the slope D of rows miss

    F C1 - D F C2

times that factor, which differs by the joint that moves and the joint whose command
steps. Left out, it looks like a lag and a gain: 0.3 % of the gains of six joints at
200 Hz and 50 Hz.
"""

import numpy as np

from seqid_cli.drive.signals import DriveSignals, kept, shifted
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.typing import Array

# The torque's lag counts in such steps here [s]: a search of it asks often.
LAG_STEP_S = 2.5e-4


def delayed_bends(log: DriveSignals, lag_s: float, total_s: float) -> Array:
    """Return what rows miss of speeds (N, n), a column for the command of each joint.

    Parameters
    ----------
    log : DriveSignals
    lag_s : float
        By which the torque's channel is late.
    total_s : float
        From a command to the torque's channel.
    """
    rounded_s = LAG_STEP_S * round(lag_s / LAG_STEP_S)

    def computed() -> Array:
        lowpass = Lowpass(log.cutoff_hz, log.rate_hz)
        speeds = lowpass(_integrals(log, total_s)[0], log.raw.valid)
        positions = lowpass(_integrals(log, total_s - rounded_s)[1], log.raw.valid)
        slopes, _ = differentiate(positions, log.rate_hz, log.raw.valid)
        return np.asarray(speeds - shifted(slopes, rounded_s * log.rate_hz))

    return kept(log, ("bends", round(1e4 * rounded_s), total_s), computed)


def _integrals(log: DriveSignals, delay_s: float) -> tuple[Array, Array]:
    """Return C1 [rad s] and C2 [rad s^2] (N, n) some time before."""
    t = log.raw.t - delay_s
    once = np.empty_like(log.q)
    twice = np.empty_like(log.q)
    for joint in range(log.q.shape[1]):
        times, column = log.command_steps(joint)
        if not len(times):
            # Nobody asks anything of it.
            once[:, joint] = twice[:, joint] = 0.0
            continue
        column = column - column.mean()
        gaps = np.diff(times)
        C1 = np.concatenate([[0.0], np.cumsum(gaps * column[:-1])])
        means = C1[:-1] + 0.5 * column[:-1] * gaps
        C2 = np.concatenate([[0.0], np.cumsum(gaps * means)])
        k = np.maximum(np.searchsorted(times, t, side="right") - 1, 0)
        past = t - times[k]
        once[:, joint] = C1[k] + column[k] * past
        twice[:, joint] = C2[k] + past * (C1[k] + 0.5 * column[k] * past)
    return once, twice
